//! Shorter plans without any search: stops that nobody needs.
//!
//! In: a plan. Out: one with no more moves, of which none can be left out alone. An object that moves twice does with
//! one of the two moves if it can wait where it is until the second, or go on to where the second leads at once.

use crate::planning::buffers::Arrangement;
use crate::planning::scene::Scene;
use crate::planning::trlb::{Move, tidy};

/// The plan without moves that can be left out.
pub fn shortened(scene: &Scene, start: &Arrangement, plan: Vec<Move>) -> Vec<Move> {
    let mut moves = tidy(plan);
    loop {
        let before = moves.len();
        let mut at = 0;
        while at < moves.len() {
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
