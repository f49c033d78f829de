//! A way for equal discs on a table that has room for hardly one more: over the sites of a packing.
//!
//! In: two arrangements. Out: moves from the one to the other, more than needed. Discs that fill the table
//! almost can all be shifted a little, and none can be put aside, so they cannot pass each other. They can
//! where they are as in a packing of one disc more: its last site is a place for one that has to make way.
//! So a packing is searched for (random points pushed apart), both arrangements are pressed (`compaction`)
//! to the sites that are nearest, and between these the discs move into the vacant site one by one.

use crate::geometry::footprint::Footprint;
use crate::geometry::polygon::Point;
use crate::geometry::pose::Pose2;
use crate::planning::auto::compaction::{Compaction, Progress};
use crate::planning::buffers::Arrangement;
use crate::planning::completion;
use crate::planning::effort::{Effort, Watch};
use crate::planning::scene::Scene;
use crate::planning::trlb::{Move, reversed};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Rounds in which all points are pushed apart.
const PUSHES: usize = 3000;

/// Sites are wider apart than they have to be by this share, so that rounding does no harm.
const MARGIN: f64 = 1e-4;

/// The radius of all movable objects if they are equal discs on a table without anything fixed.
pub fn common_radius(scene: &Scene) -> Option<f64> {
    let objects = &scene.problem.objects;
    let radius = |o: usize| match objects[o].footprint {
        Footprint::Disc { radius } => Some(radius),
        _ => None,
    };
    let first = radius(*scene.movable.first()?)?;
    let nothing_else = scene.movable.len() == objects.len() && scene.problem.keep_out.is_empty();
    let equal = |&o: &usize| radius(o).is_some_and(|r| (r - first).abs() <= 1e-9 * first);
    (nothing_else && scene.movable.iter().all(equal)).then_some(first)
}

/// Moves from `from` to `to` for discs of this radius; None if this packing, or the way to its sites, is not
/// found.
pub fn over_sites(
    scene: &Scene,
    radius: f64,
    from: &Arrangement,
    to: &Arrangement,
    rng: &mut ChaCha8Rng,
    effort: &mut Effort,
) -> Option<Vec<Move>> {
    let sites = packing(scene, radius, from.len() + 1, rng, effort)?;
    let (first, first_moves) = settled(scene, from, &sites, rng, effort)?;
    let (last, last_moves) = settled(scene, to, &sites, rng, effort)?;
    let mut moves = first_moves;
    moves.extend(permuted(scene, &sites, first, &last, effort.watch())?);
    moves.extend(reversed(last_moves));
    Some(moves)
}

/// Points that are far enough apart, and from the table's edge, for discs of this radius.
fn packing(
    scene: &Scene,
    radius: f64,
    count: usize,
    rng: &mut ChaCha8Rng,
    effort: &mut Effort,
) -> Option<Vec<Point>> {
    let apart = (2.0 * radius + scene.problem.clearance) * (1.0 + MARGIN);
    let low = radius * (1.0 + MARGIN);
    let high = [scene.problem.workspace.width - low, scene.problem.workspace.height - low];
    if low >= high[0] || low >= high[1] {
        return None;
    }
    let mut points: Vec<Point> =
        (0..count).map(|_| [rng.random_range(low..high[0]), rng.random_range(low..high[1])]).collect();
    for _ in 0..PUSHES {
        if !effort.step() || !effort.watch().go_on((points.len() * points.len() / 2) as u64) {
            return None;
        }
        if push(&mut points, apart * (1.0 + MARGIN), low, high) >= apart {
            return Some(points);
        }
    }
    None
}

/// Pushes all pairs apart once, and back onto the table; the least distance there was.
fn push(points: &mut [Point], apart: f64, low: f64, high: Point) -> f64 {
    let mut least = f64::INFINITY;
    for a in 0..points.len() {
        for b in 0..a {
            let (dx, dy) = (points[b][0] - points[a][0], points[b][1] - points[a][1]);
            let distance = dx.hypot(dy).max(1e-12);
            least = least.min(distance);
            if distance < apart {
                let share = 0.5 * (apart - distance) / distance;
                points[a] = [points[a][0] - share * dx, points[a][1] - share * dy];
                points[b] = [points[b][0] + share * dx, points[b][1] + share * dy];
            }
        }
    }
    for point in points {
        *point = [0, 1].map(|k| point[k].clamp(low, high[k]));
    }
    least
}

/// The site that each disc is pressed to, and the moves.
fn settled(
    scene: &Scene,
    from: &Arrangement,
    sites: &[Point],
    rng: &mut ChaCha8Rng,
    effort: &mut Effort,
) -> Option<(Vec<usize>, Vec<Move>)> {
    let poses: Vec<Pose2> = from.iter().map(|spot| spot.pose).collect();
    let places: Vec<Pose2> = sites.iter().map(|&[x, y]| Pose2::new(x, y, 0.0)).collect();
    let taken: Option<Vec<usize>> =
        completion::match_to_goals(&poses, &places, effort.watch()).into_iter().collect();
    let taken = taken?;
    let ends: Arrangement = taken.iter().enumerate().map(|(o, &site)| scene.spot(o, places[site])).collect();
    let mut compaction = Compaction::new(scene, from, &ends, rng);
    match compaction.run(&|_, _, _, _| None, rng, effort) {
        Progress::Arrived(moves) => Some((taken, moves)),
        Progress::Stuck | Progress::Interrupted => None,
    }
}

/// Moves from site to site, each into the one that is vacant; None where `watch` ends the work.
fn permuted(
    scene: &Scene,
    sites: &[Point],
    mut at: Vec<usize>,
    wanted: &[usize],
    watch: &mut Watch,
) -> Option<Vec<Move>> {
    let spot = |o: usize, site: usize| scene.spot(o, Pose2::new(sites[site][0], sites[site][1], 0.0));
    let mut moves = Vec::new();
    while let Some(astray) = (0..at.len()).find(|&o| at[o] != wanted[o]) {
        if !watch.go_on(sites.len() as u64) {
            return None;
        }
        let mut is_taken = vec![false; sites.len()];
        at.iter().for_each(|&site| is_taken[site] = true);
        let Some(vacant) = is_taken.iter().position(|taken| !taken) else { break };
        let object = (0..at.len()).find(|&o| wanted[o] == vacant).unwrap_or(astray);
        moves.push(Move { object, from: spot(object, at[object]), to: spot(object, vacant) });
        at[object] = vacant;
    }
    Some(moves)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::planning::auto::polish::carried_out;
    use crate::planning::problem::Problem;
    use crate::planning::random_tables::table;
    use crate::tabletop::instance::ObjectSpec;
    use rand::SeedableRng;

    /// Five discs in two rows, two and three, of which the row of three is turned round; hardly a sixth
    /// fits.
    fn crowd() -> Problem {
        let at = [(0.2, 0.2), (0.6, 0.2), (0.19, 0.7), (0.56, 0.8), (0.81, 0.5)];
        let goals = [3, 1, 4, 2, 0];
        let discs = at.iter().zip(goals).enumerate().map(|(k, (&(x, y), goal))| {
            let mut disc = ObjectSpec::new(format!("disc {k}"), Footprint::disc(0.18).unwrap());
            disc.start = Some(Pose2::new(x, y, 0.0));
            disc.goal = Some(Pose2::new(at[goal].0, at[goal].1, 0.0));
            disc
        });
        Problem::new(&table(discs.collect())).unwrap()
    }

    #[test]
    fn discs_pass_each_other_where_hardly_one_more_fits() {
        let problem = crowd();
        let scene = Scene::new(&problem);
        let radius = common_radius(&scene).unwrap();
        let start: Arrangement = (0..5).map(|o| scene.start(o).clone()).collect();
        let goal: Arrangement = (0..5).map(|o| scene.goal(o).unwrap().clone()).collect();
        let mut arrived = 0;
        for seed in 0..40 {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let mut effort = Effort::new(None, &|| false);
            let Some(moves) = over_sites(&scene, radius, &start, &goal, &mut rng, &mut effort) else {
                continue;
            };
            let steps: Vec<_> = moves.iter().map(|m| (m.object, m.to.clone())).collect();
            assert!(carried_out(&scene, &start, &steps, &mut Watch::new(&|| false)).is_some(), "seed {seed}");
            let mut now = start.clone();
            moves.iter().for_each(|m| now[m.object] = m.to.clone());
            assert!(now.iter().zip(&goal).all(|(a, b)| a.pose == b.pose), "seed {seed}");
            arrived += 1;
        }
        assert!(arrived > 0);
    }

    #[test]
    fn other_shapes_have_no_common_radius() {
        let mut instance = table(Vec::new());
        for (k, footprint) in [Footprint::disc(0.1), Footprint::rectangle(0.1, 0.1)].into_iter().enumerate() {
            let mut object = ObjectSpec::new(format!("{k}"), footprint.unwrap());
            let pose = Pose2::new(0.2 + 0.5 * k as f64, 0.5, 0.0);
            (object.start, object.goal) = (Some(pose), Some(pose));
            instance.objects.push(object);
        }
        let problem = Problem::new(&instance).unwrap();
        assert_eq!(common_radius(&Scene::new(&problem)), None);
    }
}
