//! `auto`, our own anytime solver: a portfolio of randomised searches that share their best plan.
//!
//! In: a [`PortfolioTask`]: a scene, costs, two of the paper's solvers to call; a seed. Out: plans, each
//! offered as it is found. Members (`worker`) search beside each other, on the caller's threads if there are
//! any; after a fixed number of steps they meet, in the order of their numbers, and those that have a worse
//! plan take over the best. Between the rounds the lower bound is raised (`bound::buffer_space`), as long as
//! that can end the search. So nothing but seed and steps decides what is found, however many threads there
//! are.

pub mod aside;
pub mod assignment;
pub mod compaction;
pub mod contest;
pub mod parking;
pub mod polish;
pub mod regions;
pub mod roll_out;
pub mod shorten;
pub mod sites;
pub mod stops;
pub mod table;
pub mod worker;

use crate::planning::auto::worker::{PortfolioTask, Worker};
use crate::planning::bound::buffer_space::BufferSpaceBound;
use crate::planning::effort::Effort;
use crate::planning::mcts::Verdict;
use crate::planning::trlb::Move;
use rayon::prelude::*;

/// Members: as many as there are, so many threads have work.
const MEMBERS: u64 = 4;

/// Steps of each worker in the first round; a first plan is often found within.
const FIRST_ROUND: u64 = 200;

/// Movable objects for which that is meant; with more of them the first round has fewer steps.
const FEW: u64 = 64;

/// Steps of each worker in the first round of a table of very many.
const SHORTEST_ROUND: u64 = 8;

/// Steps of each worker in the longest rounds: a fraction of a second.
const LONGEST_ROUND: u64 = 20_000;

/// A task for the portfolio.
pub struct Search<'a> {
    /// What is searched for.
    pub task: &'a PortfolioTask<'a>,
    /// Where the members work; without, one after the other.
    pub pool: Option<&'a rayon::ThreadPool>,
    /// Seed of everything.
    pub seed: u64,
}

/// Receives what is found.
pub trait Audience {
    /// A plan better than those before, to be checked.
    fn offer(&mut self, plan: &[Move]) -> Verdict;
    /// No plan is cheaper than this; true if the best one is not dearer.
    fn prove(&mut self, bound: f64) -> bool;
}

impl Search<'_> {
    /// Searches until the plan is good enough or the effort is spent.
    pub fn run(&self, audience: &mut dyn Audience, effort: &mut Effort) {
        let seed = |k: u64| self.seed.wrapping_mul(MEMBERS).wrapping_add(k);
        let worker = |k| Worker::new(self.task, k, seed(k), effort.watch());
        let mut members: Vec<Worker> = (0..MEMBERS).map(worker).collect();
        let PortfolioTask { scene, costs, .. } = *self.task;
        let mut proof = BufferSpaceBound::new(scene, costs, self.task.bound.clone(), effort.watch());
        let mut best: Option<(f64, Vec<Move>)> = None;
        // A step of a large table takes longer.
        let mut steps = (FIRST_ROUND * FEW / FEW.max(scene.movable.len() as u64)).max(SHORTEST_ROUND);
        while !effort.is_over() {
            self.round(&mut members, proof.value * self.task.worth, steps, effort);
            if self.meet(&mut members, &mut best, audience) {
                return;
            }
            let known = best.as_ref().map(|(_, plan)| plan);
            if known.is_some_and(|plan| self.prove(&mut proof, plan, steps, audience, effort)) {
                return;
            }
            steps = LONGEST_ROUND.min(steps + steps / 2);
            // A round in which no member could make a step comes to an end here.
            effort.step();
        }
    }

    fn round(&self, members: &mut [Worker], enough: f64, steps: u64, effort: &mut Effort) {
        let steps = steps.min(effort.left() / MEMBERS);
        let mut parts: Vec<Effort> = members.iter().map(|_| effort.part(steps)).collect();
        let work = |(worker, part): (&mut Worker, &mut Effort)| worker.search(enough, part);
        match self.pool {
            Some(pool) => {
                pool.install(|| members.par_iter_mut().zip(parts.par_iter_mut()).for_each(work));
            }
            None => members.iter_mut().zip(parts.iter_mut()).for_each(work),
        }
        parts.iter().for_each(|part| effort.spend(part));
    }

    /// Goes on with the proof that nothing is much better; true if the plan is shown to be the best.
    fn prove(
        &self,
        proof: &mut BufferSpaceBound,
        plan: &[Move],
        steps: u64,
        audience: &mut dyn Audience,
        effort: &mut Effort,
    ) -> bool {
        let before = proof.value;
        let enough = plan.iter().map(|m| self.task.costs[m.object]).sum();
        let mut part = effort.part(steps);
        proof.work(enough, &mut part);
        effort.spend(&part);
        proof.value > before && audience.prove(proof.value * self.task.worth)
    }

    /// Offers what is better, and hands the best plan round; true if it is good enough.
    fn meet(
        &self,
        members: &mut [Worker],
        best: &mut Option<(f64, Vec<Move>)>,
        audience: &mut dyn Audience,
    ) -> bool {
        let slack = 1e-6 * self.task.costs.iter().sum::<f64>();
        let known = |best: &Option<(f64, Vec<Move>)>| best.as_ref().map_or(f64::INFINITY, |(cost, _)| *cost);
        for worker in members.iter_mut() {
            let Some(plan) = worker.plan.as_ref().filter(|_| worker.plan_cost() < known(best) - slack) else {
                continue;
            };
            match audience.offer(plan) {
                Verdict::Enough => return true,
                Verdict::Accepted => *best = Some((worker.plan_cost(), plan.clone())),
                // The solvers' predicates and the checker's may differ within rounding.
                Verdict::Refused => worker.plan = None,
            }
        }
        for worker in members {
            if worker.plan_cost() > known(best) + slack {
                worker.plan = best.as_ref().map(|(_, plan)| plan.clone());
            }
        }
        false
    }
}
