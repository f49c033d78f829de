//! One member of the portfolio: randomised roll-outs, then pieces of its best plan solved anew.
//!
//! In: a scene, a seed, the cost of a move of each object, another way to a first plan. Out: after each round a plan
//! no dearer than before. A first plan comes from roll-outs (`roll_out`) from the start or, turned round, from the
//! goal; where none of them arrives, from the paper's solvers. From then on a piece of the plan, its tail, its head
//! (backwards) or a window, is replaced by a roll-out between the same two arrangements whenever that costs no more;
//! equal cost counts as progress, so that the plan drifts until a better one is near. Ideas: feedback vertex set as
//! bound and guide (Gao et al., TRLB), plan shortening by large-neighbourhood search.

use crate::geometry::pose::Pose2;
use crate::planning::auto::parking::{Care, Shapes};
use crate::planning::auto::roll_out::{Style, Task, roll_out};
use crate::planning::buffers::Arrangement;
use crate::planning::completion;
use crate::planning::effort::Effort;
use crate::planning::object_set::ObjectSet;
use crate::planning::scene::{Scene, Spot};
use crate::planning::trlb::{Move, reversed, tidy};
use rand::RngExt;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

/// Rounds without a plan after which the other solvers have a part in the search.
const PATIENCE: u64 = 4;

/// A search of one thread.
pub struct Member<'a> {
    scene: &'a Scene<'a>,
    costs: &'a [f64],
    rescue: &'a Rescue<'a>,
    shapes: Shapes,
    flexible: ObjectSet,
    start: Arrangement,
    goals: Vec<Option<Pose2>>,
    /// The best plan, or another one of its cost.
    pub plan: Option<Vec<Move>>,
    slack: f64,
    rng: ChaCha8Rng,
    rounds: u64,
    tries: u64,
    rescues: u64,
}

/// Another way to a plan: the number of the try, the effort.
pub type Rescue<'a> = dyn Fn(u64, &mut Effort) -> Option<Vec<Move>> + Sync + 'a;

/// A piece of a plan.
struct Piece {
    first: usize,
    last: usize,
    backwards: bool,
}

/// From one arrangement to another, at a price.
struct Leg {
    from: Arrangement,
    to: Arrangement,
    backwards: bool,
    flexible: ObjectSet,
    ceiling: f64,
}

impl<'a> Member<'a> {
    /// A member without a plan.
    pub fn new(scene: &'a Scene<'a>, costs: &'a [f64], rescue: &'a Rescue<'a>, seed: u64) -> Member<'a> {
        let goals = completion::assigned_goals(scene);
        let flexible = scene.movable.iter().copied().filter(|&o| goals[o].is_none()).collect();
        let start = (0..costs.len()).map(|i| scene.start(i).clone()).collect();
        let slack = 1e-6 * costs.iter().sum::<f64>();
        let (shapes, rng) = (Shapes::new(scene), ChaCha8Rng::seed_from_u64(seed));
        let (plan, rounds, tries, rescues) = (None, 0, 0, 0);
        Member {
            scene,
            costs,
            rescue,
            shapes,
            flexible,
            start,
            goals,
            plan,
            slack,
            rng,
            rounds,
            tries,
            rescues,
        }
    }

    /// Searches until the effort is spent, until there is a first plan, or one no dearer than `enough`.
    pub fn search(&mut self, enough: f64, effort: &mut Effort) {
        self.rounds += 1;
        if self.plan.is_none() {
            let mut part =
                if self.rounds > PATIENCE { effort.part(effort.left() / 2) } else { effort.part(u64::MAX) };
            self.first_plan(&mut part, |member, effort| member.whole_plan(f64::INFINITY, effort));
            effort.spend(&part);
            self.first_plan(effort, |member, effort| {
                member.rescues += 1;
                (member.rescue)(member.rescues, effort)
            });
            return;
        }
        // A step each time: a search that samples nothing has to come to its limit too.
        while effort.step() && self.plan_cost() > enough + self.slack {
            let Some(plan) = self.plan.take() else { return };
            let new = self.improved(&plan, effort);
            self.plan = Some(new.unwrap_or(plan));
        }
    }

    fn first_plan(&mut self, effort: &mut Effort, way: impl Fn(&mut Self, &mut Effort) -> Option<Vec<Move>>) {
        while self.plan.is_none() && effort.step() {
            self.tries += 1;
            self.plan = way(self, effort);
        }
    }

    /// Cost of the plan; infinite without one.
    pub fn plan_cost(&self) -> f64 {
        self.plan.as_ref().map_or(f64::INFINITY, |plan| self.cost(plan))
    }

    fn cost(&self, moves: &[Move]) -> f64 {
        moves.iter().map(|m| self.costs[m.object]).sum()
    }

    fn whole_plan(&mut self, ceiling: f64, effort: &mut Effort) -> Option<Vec<Move>> {
        let goal = completion::complete(self.scene, &self.goals, &mut self.rng, effort)?;
        let (backwards, flexible) = (self.tries % 3 == 2, self.flexible);
        let leg = Leg { from: self.start.clone(), to: goal, backwards, flexible, ceiling };
        let style = self.style(None, true);
        self.travel(&leg, &style, effort).map(tidy)
    }

    fn improved(&mut self, plan: &[Move], effort: &mut Effort) -> Option<Vec<Move>> {
        if plan.is_empty() || self.rng.random_bool(0.05) {
            let ceiling = self.cost(plan);
            self.tries += 1;
            return self.whole_plan(ceiling, effort);
        }
        let Piece { first, last, backwards } = self.choose(plan.len());
        let leg = Leg {
            from: self.arrangement_after(&plan[..first]),
            to: self.arrangement_after(&plan[..last]),
            backwards,
            flexible: if last == plan.len() { self.flexible } else { ObjectSet::EMPTY },
            ceiling: self.cost(&plan[first..last]),
        };
        let detours = self.rng.random_bool(0.5);
        let style = self.style(Some(plan), detours);
        let new = self.travel(&leg, &style, effort)?;
        let (head, tail) = (plan[..first].iter(), plan[last..].iter());
        Some(tidy(head.cloned().chain(new).chain(tail.cloned()).collect()))
    }

    fn travel(&mut self, leg: &Leg, style: &Style, effort: &mut Effort) -> Option<Vec<Move>> {
        let (from, to, flexible) = match leg.backwards {
            true => (&leg.to, &leg.from, ObjectSet::EMPTY),
            false => (&leg.from, &leg.to, leg.flexible),
        };
        let (scene, shapes, costs, ceiling) = (self.scene, &self.shapes, self.costs, leg.ceiling);
        let task = Task { scene, shapes, costs, from, to, flexible, ceiling };
        let moves = roll_out(&task, style, &mut self.rng, effort)?;
        Some(if leg.backwards { reversed(moves) } else { moves })
    }

    fn arrangement_after(&self, moves: &[Move]) -> Arrangement {
        let mut arrangement = self.start.clone();
        moves.iter().for_each(|m| arrangement[m.object] = m.to.clone());
        arrangement
    }

    /// Tail, head or window of a plan that is not empty, whose cost is to be undercut.
    fn choose(&mut self, length: usize) -> Piece {
        let rng = &mut self.rng;
        match rng.random_range(0..10u8) {
            0..=3 => Piece { first: rng.random_range(0..length), last: length, backwards: false },
            4..=7 => Piece { first: 0, last: rng.random_range(1..=length), backwards: true },
            _ => {
                let span = length.min(rng.random_range(4..=30));
                let first = rng.random_range(0..=length - span);
                Piece { first, last: first + span, backwards: rng.random_bool(0.5) }
            }
        }
    }

    /// How the next roll-out goes about it; plans on the way give it places and favourites.
    fn style(&mut self, plan: Option<&[Move]>, detours: bool) -> Style {
        let count = self.costs.len();
        let rng = &mut self.rng;
        let care = match rng.random_range(0..6u8) {
            0..=2 => Care { samples: 20, angles: 0, pivots: 0 },
            3 | 4 => Care { samples: 60, angles: 1, pivots: 8 },
            _ => Care { samples: 120, angles: 3, pivots: 16 },
        };
        let mut bias: Vec<f64> = (0..count).map(|_| rng.random_range(1.0..2.0)).collect();
        let mut hints: Vec<Vec<Arc<Spot>>> = vec![Vec::new(); count];
        let hinted = rng.random_bool(0.5);
        for m in plan.unwrap_or_default() {
            let is_end = self.scene.goal(m.object).is_some_and(|goal| goal.pose == m.to.pose);
            if hinted && !is_end && rng.random_bool(0.8) {
                hints[m.object].push(m.to.clone());
                bias[m.object] = rng.random_range(0.0..1.3);
            }
        }
        let hold = if rng.random_bool(0.2) { 0.1 } else { 0.0 };
        let stops = if rng.random_bool(0.5) { rng.random_range(1..=2) } else { 0 };
        Style { care, bias, hints, hold, stops, detours }
    }
}
