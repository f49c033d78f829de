//! One worker of the portfolio: randomised roll-outs, then pieces of its best plan solved anew.
//!
//! In: a task that all members share, a seed. Out: after each round a plan no dearer than before. A first
//! plan comes from a plan known before, from roll-outs (`roll_out`) from the start or, turned round, from
//! the goal; where none of them arrives, from pressing everything out of the way (`compaction`); two members
//! call the paper's solvers and nothing else, once a few rounds have found none. From then on a piece of the
//! plan, its tail, its head (backwards) or a window, is replaced by a roll-out between the same two
//! arrangements whenever that costs no more; equal cost counts as progress, so that the plan drifts until a
//! better one is near. Under the objective `time` the roll-outs count moves, the caller's cost function
//! judges what they find, and `polish` tries what no count of moves can distinguish. Ideas: feedback vertex
//! set as bound and guide (Gao et al., TRLB), plan shortening by large-neighbourhood search.

use crate::geometry::pose::Pose2;
use crate::planning::auto::assignment::Groups;
use crate::planning::auto::compaction::{Compaction, Progress};
use crate::planning::auto::parking::{Care, Shapes};
use crate::planning::auto::polish;
use crate::planning::auto::roll_out::{Style, Task, roll_out};
use crate::planning::auto::shorten::shortened;
use crate::planning::auto::sites;
use crate::planning::bound::Parts;
use crate::planning::buffers::Arrangement;
use crate::planning::completion;
use crate::planning::effort::{Effort, Watch};
use crate::planning::object_set::ObjectSet;
use crate::planning::scene::{Scene, Spot};
use crate::planning::trlb::{Move, reversed, tidy};
use rand::RngExt;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

/// Rounds without a plan after which everything is tried side by side.
const PATIENCE: u64 = 8;

/// Times the bound from which on a plan is so poor that a fallback solver is called all the same.
const POOR: f64 = 1.5;

/// Rounds after which nothing better is hoped for from a fallback solver any more.
const HOPE: u64 = 100;

/// Share of the ways over a crowded table that go over the sites of a packing, if they can.
const SITES: f64 = 0.3;

/// Under `time`, the share of small changes among the tries.
const POLISH: f64 = 0.9;

/// What all members search for.
#[derive(Clone, Copy)]
pub struct PortfolioTask<'a> {
    /// The scene.
    pub scene: &'a Scene<'a>,
    /// Cost of a move of each object, positive.
    pub costs: &'a [f64],
    /// What a plan costs if that is not the sum of its moves' costs.
    pub judge: Option<&'a Judge<'a>>,
    /// What a unit of these costs is worth at least in the objective.
    pub worth: f64,
    /// A worker's fallback solver, if it has one: its number, a seed.
    pub fallback: &'a (dyn Fn(u64, u64) -> Option<Fallback<'a>> + Sync + 'a),
    /// What the bound is put together from, by these costs.
    pub bound: &'a Parts,
    /// A plan made before, perhaps for objects that lie elsewhere now: who was to go where.
    pub known: &'a [(usize, Pose2)],
}

/// Cost of a whole plan.
pub type Judge<'a> = dyn Fn(&[Move]) -> f64 + Sync + 'a;

/// Another way to a plan, unchecked; it goes on where it was left when the effort was spent.
pub type Search<'a> = dyn FnMut(&mut Effort) -> Option<Vec<Move>> + Send + 'a;

/// A search of another kind, for a first plan.
pub struct Fallback<'a> {
    /// The search.
    pub search: Box<Search<'a>>,
    /// The first round of its worker in which it is called.
    pub from_round: u64,
    /// Its steps that count one of the roll-outs.
    pub steps: u64,
    /// It may find what betters a poor plan.
    pub betters: bool,
}

/// A search of one thread.
pub struct Worker<'a> {
    task: &'a PortfolioTask<'a>,
    shapes: Shapes,
    groups: Groups,
    start: Arrangement,
    goals: Vec<Option<Pose2>>,
    /// The best plan, or another one of its cost.
    pub plan: Option<Vec<Move>>,
    slack: f64,
    rng: ChaCha8Rng,
    rounds: u64,
    tries: u64,
    fallback: Option<Fallback<'a>>,
    /// A way over a crowded table that is under way, and whether it leads from the goal to the start.
    compaction: Option<(Compaction<'a>, bool)>,
}

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

impl<'a> Worker<'a> {
    /// The worker of this number, without a plan.
    pub fn new(task: &'a PortfolioTask<'a>, number: u64, seed: u64, watch: &mut Watch) -> Worker<'a> {
        let scene = task.scene;
        Worker {
            task,
            shapes: Shapes::new(scene),
            groups: Groups::new(scene),
            start: scene.starts().to_vec(),
            goals: completion::assigned_goals(scene, watch),
            plan: None,
            slack: 1e-6 * task.costs.iter().sum::<f64>(),
            rng: ChaCha8Rng::seed_from_u64(seed),
            rounds: 0,
            tries: 0,
            fallback: (task.fallback)(number, seed),
            compaction: None,
        }
    }

    /// Searches until the effort is spent, until there is a first plan, or one no dearer than `enough`.
    pub fn search(&mut self, enough: f64, effort: &mut Effort) {
        self.rounds += 1;
        if self.plan.is_none() {
            self.improved_by_fallback(f64::INFINITY, effort);
            self.first_plan(2, effort, |worker, effort| match worker.tries {
                1..=3 if !worker.task.known.is_empty() => worker.resumed(effort),
                _ => worker.whole_plan(f64::INFINITY, effort),
            });
            self.first_plan(1, effort, Self::compacted);
            return;
        }
        self.fallback = self.fallback.take().filter(|fallback| fallback.betters);
        let mut cost = self.plan_cost();
        if self.is_poor(cost, enough) {
            cost = self.improved_by_fallback(cost, effort);
        }
        // A step each time: a search that samples nothing has to come to its limit too.
        while effort.step() && cost > enough + self.slack {
            let Some(plan) = self.plan.take() else { return };
            let new = self.varied(&plan, effort).map(|new| (self.judged(&new), new));
            // Equal moves may take more time; equal time is progress as equal moves are.
            let better = new.filter(|(new_cost, _)| *new_cost <= cost + self.slack);
            let (kept_cost, kept) = better.unwrap_or((cost, plan));
            cost = kept_cost;
            self.plan = Some(kept);
        }
    }

    /// Calls this worker's fallback solver, if it has one, for a plan that costs less than `cost`; what the
    /// best one costs then.
    fn improved_by_fallback(&mut self, cost: f64, effort: &mut Effort) -> f64 {
        let Some(mut fallback) = self.fallback.take() else { return cost };
        if self.rounds < fallback.from_round {
            self.fallback = Some(fallback);
            return cost;
        }
        let mut part = effort.cheap_part(fallback.steps);
        let found = (fallback.search)(&mut part);
        effort.spend_cheap(&part, fallback.steps);
        let Some(plan) = found else {
            self.fallback = Some(fallback);
            return cost;
        };
        // The first one is the last one: what is still to gain, changes of pieces find sooner.
        let plan = shortened(self.task.scene, &self.start, plan, effort.watch());
        let new = self.judged(&plan);
        if new < cost {
            self.plan = Some(plan);
        }
        cost.min(new)
    }

    /// Does the fallback solver promise more than changes of pieces of a plan of this cost?
    fn is_poor(&self, cost: f64, enough: f64) -> bool {
        // Bounds say little where the caller judges.
        let far = self.task.judge.is_none() && cost > POOR * enough;
        far && self.rounds <= HOPE && self.fallback.as_ref().is_some_and(|fallback| fallback.betters)
    }

    /// Tries to find a plan in one of `parts` of the effort; in all of it while there is hope for an easy
    /// one.
    fn first_plan(
        &mut self,
        parts: u64,
        effort: &mut Effort,
        way: impl Fn(&mut Self, &mut Effort) -> Option<Vec<Move>>,
    ) {
        let most = if self.rounds <= PATIENCE { u64::MAX } else { effort.left() / parts };
        let mut part = effort.part(most);
        while self.plan.is_none() && part.step() {
            self.tries += 1;
            self.plan = way(self, &mut part);
        }
        effort.spend(&part);
    }

    /// Cost of the plan; infinite without one.
    pub fn plan_cost(&self) -> f64 {
        self.plan.as_ref().map_or(f64::INFINITY, |plan| self.judged(plan))
    }

    fn judged(&self, moves: &[Move]) -> f64 {
        self.task.judge.map_or_else(|| self.cost(moves), |judge| judge(moves))
    }

    /// What the roll-outs count.
    fn cost(&self, moves: &[Move]) -> f64 {
        moves.iter().map(|m| self.task.costs[m.object]).sum()
    }

    /// What is still possible of the plan known before, and the way from there.
    fn resumed(&mut self, effort: &mut Effort) -> Option<Vec<Move>> {
        let scene = self.task.scene;
        let goal = completion::complete(scene, &self.goals, &mut self.rng, effort)?;
        let mut now = self.start.clone();
        let mut moves = Vec::new();
        // All of it at first, then ever less.
        let share = self.task.known.len() / self.tries as usize;
        for (object, pose) in &self.task.known[..share] {
            let to = if pose.same(&goal[*object].pose) {
                goal[*object].clone()
            } else {
                scene.spot(*object, *pose)
            };
            if !effort.watch().go_on(scene.row_ticks()) {
                return None;
            }
            let free = |o: &&usize| *o == object || scene.clear(&to, &now[**o]);
            let possible = now[*object].pose != to.pose
                && scene.on_table(*object, &to.pose)
                && scene.admissible(&to)
                && scene.movable.iter().all(|o| free(&o));
            if possible && effort.step() {
                let from = std::mem::replace(&mut now[*object], to.clone());
                moves.push(Move { object: *object, from, to });
            }
        }
        let flexible = self.groups.flexible(scene, &goal);
        let mut ends = goal;
        for o in &flexible {
            if !effort.watch().go_on(scene.row_ticks()) {
                return None;
            }
            // An object that may end anywhere stays where it was put, if no other is to end there.
            let mut others = scene.movable.iter().filter(|&&other| other != o);
            if others.all(|&other| scene.clear(&now[o], &ends[other])) {
                ends[o] = now[o].clone();
            }
        }
        let leg = Leg { from: now, to: ends, backwards: false, flexible, ceiling: f64::INFINITY };
        let style = self.style(None, true);
        moves.extend(self.travel(&leg, &style, effort)?);
        Some(tidy(moves))
    }

    fn whole_plan(&mut self, ceiling: f64, effort: &mut Effort) -> Option<Vec<Move>> {
        let PortfolioTask { scene, costs, .. } = *self.task;
        let goal = completion::complete(scene, &self.goals, &mut self.rng, effort)?;
        let goal = self.groups.improved(scene, costs, &self.start, goal, &mut self.rng, effort.watch());
        let flexible = self.groups.flexible(scene, &goal);
        let backwards = self.tries % 3 == 2;
        let leg = Leg { from: self.start.clone(), to: goal, backwards, flexible, ceiling };
        let style = self.style(None, true);
        self.travel(&leg, &style, effort).map(tidy)
    }

    /// Goes on with a way over a crowded table, or begins one.
    fn compacted(&mut self, effort: &mut Effort) -> Option<Vec<Move>> {
        let scene = self.task.scene;
        let (mut compaction, backwards) = match self.compaction.take() {
            Some(compaction) => compaction,
            None if self.rng.random_bool(SITES) => return self.over_sites(effort),
            None => self.new_compaction(effort)?,
        };
        let style = Style { hold: 0.0, stops: 0, ..self.style(None, false) };
        let (costs, shapes, ceiling) = (self.task.costs, &self.shapes, f64::INFINITY);
        let shortcut = |from: &Arrangement, to: &Arrangement, rng: &mut ChaCha8Rng, effort: &mut Effort| {
            let task = Task { scene, shapes, costs, from, to, flexible: ObjectSet::EMPTY, ceiling };
            roll_out(&task, &style, rng, effort)
        };
        match compaction.run(&shortcut, &mut self.rng, effort) {
            Progress::Arrived(moves) => {
                let moves = if backwards { reversed(moves) } else { moves };
                Some(shortened(scene, &self.start, moves, effort.watch()))
            }
            Progress::Stuck => None,
            Progress::Interrupted => {
                self.compaction = Some((compaction, backwards));
                None
            }
        }
    }

    /// A way for equal discs, if that is what there is.
    fn over_sites(&mut self, effort: &mut Effort) -> Option<Vec<Move>> {
        let scene = self.task.scene;
        let radius = sites::common_radius(scene)?;
        let goal = completion::complete(scene, &self.goals, &mut self.rng, effort)?;
        let moves = sites::over_sites(scene, radius, &self.start, &goal, &mut self.rng, effort)?;
        Some(shortened(scene, &self.start, moves, effort.watch()))
    }

    fn new_compaction(&mut self, effort: &mut Effort) -> Option<(Compaction<'a>, bool)> {
        let PortfolioTask { scene, costs, .. } = *self.task;
        let goal = completion::complete(scene, &self.goals, &mut self.rng, effort)?;
        let goal = self.groups.improved(scene, costs, &self.start, goal, &mut self.rng, effort.watch());
        let backwards = self.rng.random_bool(0.5);
        let (from, to) = if backwards { (&goal, &self.start) } else { (&self.start, &goal) };
        Some((Compaction::new(scene, from, to, &mut self.rng), backwards))
    }

    /// Another plan that costs no more moves.
    fn varied(&mut self, plan: &[Move], effort: &mut Effort) -> Option<Vec<Move>> {
        if self.task.judge.is_some() && !plan.is_empty() && self.rng.random_bool(POLISH) {
            return polish::neighbour(self.task.scene, &self.start, plan, &mut self.rng, effort.watch());
        }
        if plan.is_empty() || self.rng.random_bool(0.05) {
            let ceiling = self.cost(plan);
            self.tries += 1;
            return self.whole_plan(ceiling, effort);
        }
        let Piece { first, last, backwards } = self.choose(plan.len());
        let to = self.arrangement_after(&plan[..last]);
        let to = if last == plan.len() { self.with_other_ends(to) } else { to };
        let ends_here = last == plan.len();
        let leg = Leg {
            from: self.arrangement_after(&plan[..first]),
            flexible: if ends_here { self.groups.flexible(self.task.scene, &to) } else { ObjectSet::EMPTY },
            to,
            backwards,
            ceiling: self.cost(&plan[first..last]),
        };
        let detours = self.rng.random_bool(0.5);
        let style = self.style(Some(plan), detours);
        let new = self.travel(&leg, &style, effort)?;
        let (head, tail) = (plan[..first].iter(), plan[last..].iter());
        let moves = head.cloned().chain(new).chain(tail.cloned()).collect();
        Some(shortened(self.task.scene, &self.start, moves, effort.watch()))
    }

    /// Sometimes members of a group take each other's ends.
    fn with_other_ends(&mut self, ends: Arrangement) -> Arrangement {
        if self.groups.is_empty() || self.rng.random_bool(0.5) {
            return ends;
        }
        self.groups.exchanged(self.task.scene, &ends, &mut self.rng).unwrap_or(ends)
    }

    fn travel(&mut self, leg: &Leg, style: &Style, effort: &mut Effort) -> Option<Vec<Move>> {
        let (from, to, flexible) = match leg.backwards {
            true => (&leg.to, &leg.from, ObjectSet::EMPTY),
            false => (&leg.from, &leg.to, leg.flexible.clone()),
        };
        let (PortfolioTask { scene, costs, .. }, shapes, ceiling) = (*self.task, &self.shapes, leg.ceiling);
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
        let most = 2 * self.start.len();
        let rng = &mut self.rng;
        // No roll-out takes the place of much of a plan that long.
        if length > most.max(4) && rng.random_bool(0.9) {
            let span = rng.random_range(4..=most.max(4));
            let first = rng.random_range(0..=length - span);
            return Piece { first, last: first + span, backwards: rng.random_bool(0.5) };
        }
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
        let count = self.start.len();
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
            let is_end = self.task.scene.goal(m.object).is_some_and(|goal| goal.pose == m.to.pose);
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
