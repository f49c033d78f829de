//! A way for the arm from wherever it was left to where it is to be, round everything it could touch.
//!
//! In: the arm's model, the room, joints at both ends, a seed, a bound of steps. Out: joint positions
//! between which the straight ways are free, or why there are none. Pure; the same seed finds the same way.
//!
//! Where the straight joint move is free, it is the way. Else two trees grow towards each other from the
//! ends (RRT-Connect: Kuffner and LaValle, ICRA 2000), first near both ends, then ever wider; what is found
//! is cut short. Full turns of joints are different places: a way never winds a joint beyond its range.

use crate::bodies::Room;
use crate::bodies::sweep::{Meeting, Sweep, Zone};
use crate::path::ArmModel;
use cell_values::units::Joints;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Longest stride of a tree, rad of the leading joint.
const STRIDE_RAD: f64 = 0.6;

/// Tries to cut a way short.
const SHORTCUTS: usize = 60;

/// How far round both ends joints are tried at first, rad; doubled each time a share of the steps is used
/// up.
const NEAR_RAD: f64 = 0.8;

/// The far end of a way, in words.
pub const THERE: &str = "there";

/// How a search is bounded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Search {
    /// Of the random choices.
    pub seed: u64,
    /// Checked straight pieces at most.
    pub steps: usize,
}

/// Why there is no way.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum NoWay {
    /// The arm touches something, or nearly, before it has moved.
    #[error("where the arm is, {} and {} are too near to each other", .0.one, .0.other)]
    Start(Meeting),
    /// It would at the other end.
    #[error("there, {} and {} would be too near to each other", .0.one, .0.other)]
    Target(Meeting),
    /// A joint is outside its range at one of the ends.
    #[error("{place}, joint {joint} is outside its range")]
    Range {
        /// Which end, in words.
        place: &'static str,
        /// Joint number, 1 to 6.
        joint: usize,
    },
    /// The search ended without one.
    #[error("no free way was found in {steps} steps; on the straight way {} and {} would meet",
            .meeting.one, .meeting.other)]
    NotFound {
        /// Pieces that were checked.
        steps: usize,
        /// What is in the straight way.
        meeting: Meeting,
    },
}

/// Joint positions from `from` (not among them) to `to` (the last), with free straight ways between them.
///
/// # Errors
/// [`NoWay`].
pub fn find(
    model: &ArmModel,
    room: &Room,
    from: &Joints,
    to: &Joints,
    search: Search,
) -> Result<Vec<Joints>, NoWay> {
    for (q, place) in [(from, "where the arm is"), (to, THERE)] {
        if let Some(joint) = model.outside_range(q) {
            return Err(NoWay::Range { place, joint: joint + 1 });
        }
    }
    let mut sweep = Sweep::new(&model.bodies, room);
    sweep.way_out(from, from).map_err(NoWay::Start)?;
    sweep.place(to, Zone::Over).map_err(NoWay::Target)?;
    let meeting = match sweep.way_out(from, to) {
        Ok(()) => return Ok(vec![*to]),
        Err(meeting) => meeting,
    };
    let mut search = Trees {
        model,
        sweep,
        random: ChaCha8Rng::seed_from_u64(search.seed),
        ends: [*from, *to],
        trees: [*from, *to].map(|root| vec![Node { q: root, parent: 0 }]),
        steps: 0,
        bound: search.steps.max(1),
    };
    match search.grow() {
        Some(points) => Ok(search.shortened(points)),
        None => Err(NoWay::NotFound { steps: search.steps, meeting }),
    }
}

struct Node {
    q: Joints,
    /// Index of the node it was reached from; the root is its own.
    parent: usize,
}

struct Trees<'a> {
    model: &'a ArmModel,
    sweep: Sweep<'a>,
    random: ChaCha8Rng,
    ends: [Joints; 2],
    trees: [Vec<Node>; 2],
    steps: usize,
    bound: usize,
}

impl Trees<'_> {
    /// Until the trees meet or the steps are used up; all points from one end to the other.
    fn grow(&mut self) -> Option<Vec<Joints>> {
        let mut side = 0;
        while self.steps < self.bound {
            let wanted = self.sample();
            if let Some(reached) = self.extend(side, &wanted) {
                let goal = self.trees[side][reached].q;
                if let Some(met) = self.connect(1 - side, &goal) {
                    return Some(self.joined(side, reached, met));
                }
            }
            side = 1 - side;
        }
        None
    }

    /// Anywhere in the joints' ranges, at first near both ends.
    fn sample(&mut self) -> Joints {
        let widened = NEAR_RAD * f64::powi(2.0, (8 * self.steps / self.bound) as i32);
        let [from, to] = self.ends;
        Joints(std::array::from_fn(|joint| {
            let (low, high) = self.model.limits.joint_range[joint];
            let (a, b) = (from.0[joint], to.0[joint]);
            let (low, high) = (low.max(a.min(b) - widened), high.min(a.max(b) + widened));
            if low < high { self.random.random_range(low..high) } else { low }
        }))
    }

    /// One stride of a tree towards `wanted`; the new node.
    fn extend(&mut self, side: usize, wanted: &Joints) -> Option<usize> {
        let tree = &self.trees[side];
        let distance = |node: &Node| (0..6).map(|j| (node.q.0[j] - wanted.0[j]).powi(2)).sum::<f64>();
        let nearest = (0..tree.len()).min_by(|a, b| distance(&tree[*a]).total_cmp(&distance(&tree[*b])))?;
        self.stride(side, nearest, wanted)
    }

    fn stride(&mut self, side: usize, from: usize, wanted: &Joints) -> Option<usize> {
        let q = self.trees[side][from].q;
        let far = q.max_difference(wanted);
        let next = if far <= STRIDE_RAD { *wanted } else { q.lerp(wanted, STRIDE_RAD / far) };
        self.steps += 1;
        let from_the_start = side == 0 && from == 0;
        self.free(from_the_start, &q, &next).then_some(())?;
        self.trees[side].push(Node { q: next, parent: from });
        Some(self.trees[side].len() - 1)
    }

    /// Strides of the other tree as long as they are free; its node at `goal`, if it gets there.
    fn connect(&mut self, side: usize, goal: &Joints) -> Option<usize> {
        let mut at = self.extend(side, goal)?;
        while self.trees[side][at].q.max_difference(goal) > 1e-12 {
            if self.steps >= self.bound {
                return None;
            }
            at = self.stride(side, at, goal)?;
        }
        Some(at)
    }

    /// The straight way between two points; one that leaves where the arm was left may begin too near.
    fn free(&mut self, from_the_start: bool, from: &Joints, to: &Joints) -> bool {
        let sweep = &mut self.sweep;
        if from_the_start { sweep.way_out(from, to).is_ok() } else { sweep.way(from, to).is_ok() }
    }

    fn joined(&self, side: usize, reached: usize, met: usize) -> Vec<Joints> {
        let [first, second] = if side == 0 { [reached, met] } else { [met, reached] };
        let mut points = self.branch(0, first);
        points.reverse();
        points.extend(self.branch(1, second).into_iter().skip(1));
        points
    }

    /// From a node to the root of its tree.
    fn branch(&self, side: usize, from: usize) -> Vec<Joints> {
        let tree = &self.trees[side];
        let mut points = vec![tree[from].q];
        let mut at = from;
        while tree[at].parent != at {
            at = tree[at].parent;
            points.push(tree[at].q);
        }
        points
    }

    /// Cuts corners where the straight way between two points of the way is free. Without the first point.
    fn shortened(&mut self, mut points: Vec<Joints>) -> Vec<Joints> {
        for _ in 0..SHORTCUTS {
            if points.len() <= 2 {
                break;
            }
            let first = self.random.random_range(0..points.len() - 2);
            let last = self.random.random_range(first + 2..points.len());
            if self.free(first == 0, &points[first], &points[last]) {
                points.drain(first + 1..last);
            }
        }
        points.remove(0);
        points
    }
}
