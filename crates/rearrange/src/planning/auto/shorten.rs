//! Shorter plans without any search: stops that are not needed.
//!
//! In: a plan. Out: one with no more moves, of which none can be left out alone. An object that moves twice
//! does with one of the two moves if it can wait where it is until the second, or go on to where the second
//! leads at once.

use crate::planning::buffers::Arrangement;
use crate::planning::effort::Watch;
use crate::planning::scene::Scene;
use crate::planning::trlb::{Move, tidy};

/// The plan without moves that can be left out; without those found until then where `watch` ends the work.
pub fn shortened(scene: &Scene, start: &Arrangement, plan: Vec<Move>, watch: &mut Watch) -> Vec<Move> {
    let mut moves = tidy(plan);
    loop {
        let before = moves.len();
        let mut at = 0;
        while at < moves.len() {
            if !watch.go_on(moves.len() as u64 + scene.row_ticks()) {
                return tidy(moves);
            }
            if !(drop_by_waiting(scene, &mut moves, at) || drop_by_going_on(scene, start, &mut moves, at)) {
                at += 1;
            }
        }
        moves = tidy(moves);
        if moves.len() == before {
            return moves;
        }
    }
}

fn next_of(moves: &[Move], at: usize) -> Option<usize> {
    (at + 1..moves.len()).find(|&k| moves[k].object == moves[at].object)
}

/// Leaves out the move at `at` if its object can stay where it is until its next one.
fn drop_by_waiting(scene: &Scene, moves: &mut Vec<Move>, at: usize) -> bool {
    let Some(next) = next_of(moves, at) else { return false };
    let here = moves[at].from.clone();
    if !moves[at + 1..next].iter().all(|m| scene.clear(&m.to, &here)) {
        return false;
    }
    moves[next].from = here;
    moves.remove(at);
    true
}

/// Leads the move at `at` to where the object's next one does, if it can be there so early.
fn drop_by_going_on(scene: &Scene, start: &Arrangement, moves: &mut Vec<Move>, at: usize) -> bool {
    let Some(next) = next_of(moves, at) else { return false };
    let (object, there) = (moves[at].object, moves[next].to.clone());
    if !moves[at + 1..next].iter().all(|m| scene.clear(&m.to, &there)) {
        return false;
    }
    let mut now = start.clone();
    moves[..at].iter().for_each(|m| now[m.object] = m.to.clone());
    let mut others = scene.movable.iter().filter(|&&o| o != object);
    if !others.all(|&o| scene.clear(&there, &now[o])) {
        return false;
    }
    moves[at].to = there;
    moves.remove(next);
    true
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::footprint::Footprint;
    use crate::geometry::pose::Pose2;
    use crate::planning::auto::polish::carried_out;
    use crate::planning::problem::Problem;
    use crate::planning::random_tables::{random_instance, table};
    use crate::tabletop::instance::ObjectSpec;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn moves(scene: &Scene, steps: &[(usize, f64, f64)]) -> Vec<Move> {
        let mut now: Arrangement = scene.movable.iter().map(|&o| scene.start(o).clone()).collect();
        let step = |&(object, x, y): &(usize, f64, f64)| {
            let to = scene.spot(object, Pose2::new(x, y, 0.0));
            Move { object, from: std::mem::replace(&mut now[object], to.clone()), to }
        };
        steps.iter().map(step).collect()
    }

    #[test]
    fn a_stop_goes_where_waiting_or_going_on_will_do_and_stays_where_it_is_needed() {
        let discs = [(0.2, 0.5, 0.8), (0.8, 0.5, 0.2)].map(|(x, y, goal)| {
            let mut disc = ObjectSpec::new(format!("disc at {x}"), Footprint::disc(0.1).unwrap());
            (disc.start, disc.goal) = (Some(Pose2::new(x, y, 0.0)), Some(Pose2::new(goal, y, 0.0)));
            disc
        });
        let problem = Problem::new(&table(discs.to_vec())).unwrap();
        let scene = Scene::new(&problem);
        let start: Arrangement = vec![scene.start(0).clone(), scene.start(1).clone()];
        let steps = [(0, 0.2, 0.9), (1, 0.5, 0.1), (0, 0.5, 0.8), (1, 0.2, 0.5), (0, 0.8, 0.5)];
        let plan = shortened(&scene, &start, moves(&scene, &steps), &mut Watch::new(&|| false));
        assert_eq!(plan.len(), 3, "{plan:?}");
        let steps: Vec<_> = plan.iter().map(|m| (m.object, m.to.clone())).collect();
        let carried = carried_out(&scene, &start, &steps, &mut Watch::new(&|| false)).unwrap();
        assert!(carried.iter().zip(&plan).all(|(a, b)| a.from.pose == b.from.pose));
    }

    #[test]
    fn a_shortened_plan_ends_alike_over_free_places() {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        for _ in 0..30 {
            let problem = Problem::new(&random_instance(&mut rng, 4)).unwrap();
            let scene = Scene::new(&problem);
            let start: Arrangement = (0..4).map(|o| scene.start(o).clone()).collect();
            let mut now = start.clone();
            let mut plan = Vec::new();
            for _ in 0..200 {
                let object = rng.random_range(0..4);
                let Some(to) = scene.sample(object, &mut rng) else { continue };
                if (0..4).all(|o| o == object || scene.clear(&to, &now[o])) {
                    plan.push(Move { object, from: std::mem::replace(&mut now[object], to.clone()), to });
                }
            }
            let before = plan.len();
            let short = shortened(&scene, &start, plan, &mut Watch::new(&|| false));
            assert!(short.len() < before.max(1), "{} of {before}", short.len());
            let steps: Vec<_> = short.iter().map(|m| (m.object, m.to.clone())).collect();
            carried_out(&scene, &start, &steps, &mut Watch::new(&|| false)).unwrap();
            let mut then = start.clone();
            short.iter().for_each(|m| then[m.object] = m.to.clone());
            assert!(then.iter().zip(&now).all(|(a, b)| a.pose == b.pose));
        }
    }
}
