//! What becomes of the machine's effects, what the shell around it hands over, and what the person does who
//! approves plans.
//!
//! In: an effect. Out: calls of network, disk and camera, orders, answers that come after a seeded time,
//! values for people.

use crate::pair::rules::ShellNow;
use crate::pair::{Later, Pair};
use cell_machine::event::{Effect, Event, News};
use cell_machine::planner::answer;
use cell_machine::supervisor::input::{PlanAnswer, PlanRequest, Record};
use rand::RngExt;
use ur_sim::motion::FRAME_SECONDS;
use ur_sim::world::lock;

/// Seconds that planning takes, from and to.
const PLANNING_S: (f64, f64) = (0.005, 0.08);

/// Seconds that putting a look together takes, from and to.
const OBSERVING_S: (f64, f64) = (0.002, 0.02);

impl Pair {
    fn after(&mut self, (from, to): (f64, f64), event: Event) {
        let seconds = self.rng.random_range(from..to);
        let due = self.frame + (seconds / FRAME_SECONDS) as u64 + 1;
        self.later.push(Later { due, event });
    }

    pub(super) fn carry_out(&mut self, effect: Effect) {
        self.trace.effect(self.frame, &effect);
        self.rules.effect(self.frame, &effect, &self.machine);
        match effect {
            Effect::Connect(link) => self.network.connect(self.frame, link),
            Effect::Close(link) => self.network.close(&mut self.simulator, link),
            Effect::Send(link, bytes) => self.network.send(self.frame, link, bytes),
            Effect::Registers(request) => self.network.transact(self.frame, &mut self.simulator, request),
            Effect::Look { number, frames, table_from_camera } => {
                let now_s = lock(&self.simulator.core().world).now_s();
                self.camera_view.look(now_s, number, frames, table_from_camera);
            }
            Effect::Observe { number, views, partial, held } => {
                let seen = self.camera_view.observe(&views, partial.as_ref(), held.as_ref());
                self.after(OBSERVING_S, Event::Observed(number, seen));
            }
            Effect::Plan { number, request } => {
                let plan = self.plan(&request);
                self.after(PLANNING_S, Event::Planned(number, Box::new(plan)));
            }
            Effect::Commit { number, record } => {
                if let Record::Planned(note) = &record {
                    self.plan_shown = Some(note.number).filter(|number| *number > 0).or(self.plan_shown);
                }
                self.disk.commit(self.frame, number, record);
            }
            Effect::Reply { number, reply } => {
                self.shell.answered(number);
                self.replies.push_back((number, reply));
            }
            Effect::WantJob => self.store.wanted(),
            Effect::Notify(news) => self.notify(news),
            Effect::End(how) => self.ended = Some(how.map_err(|fault| fault.to_string())),
            Effect::Picture { number, pose, base_from_flange } => {
                let now_s = lock(&self.simulator.core().world).now_s();
                self.camera_view.picture(now_s, number, pose, base_from_flange);
            }
            Effect::RoundOver(result) => self.round_over = Some(result),
            // A plan takes no time of its own here.
            Effect::CancelPlan => {}
        }
    }

    fn plan(&self, request: &PlanRequest) -> PlanAnswer {
        answer(request, Some(self.choice.plan_work), &|_| false, &|| 0.0)
    }

    fn notify(&mut self, news: News) {
        match news {
            News::Identified(_) => {
                let mut model = Box::new(self.stage.model.clone());
                model.held_before = self.store.held_before().cloned();
                self.due.push(Event::Commission { model, arm: false });
            }
            News::Notice(notice) => self.notices.push(notice),
            News::Status(status) => self.status = Some(*status),
            News::Route(_) | News::Ended(_) => {}
        }
    }

    /// What people and the shell do in this frame; false while celld's process stands still.
    pub(super) fn take_orders(&mut self, events: &mut Vec<Event>) -> bool {
        let (frame, mut happened) = (self.frame, Vec::new());
        self.shell.people(frame, &mut happened);
        let runs = !self.shell.is_stopped(frame);
        if runs && self.ended.is_none() {
            let handed = self.shell.step(frame);
            happened.extend(handed.happened);
            // What the shell knows comes first, as in a turn of the daemon's loop.
            for event in &handed.events {
                if let Event::Order(number, order, _) = event {
                    self.trace.line(frame, || format!("order {number} {order:?} through the shell"));
                    self.rules.ordered(*number, order);
                }
            }
            events.splice(0..0, handed.events);
        }
        for one in &happened {
            self.rules.on_the_way(frame, one, self.shell.clients());
        }
        let (runs_on, folder, cut_off) =
            (runs && self.ended.is_none(), self.shell.folder(), self.shell.is_cut_off());
        self.rules.shell(ShellNow { runs: runs_on, folder, cut_off });
        runs
    }

    /// What the person does who approves plans.
    pub(super) fn take_approval(&mut self) {
        let (Some(operator), Some(plan), Some(status)) = (&mut self.operator, self.plan_shown, &self.status)
        else {
            return;
        };
        let Some(job) = status.job.as_deref().filter(|_| status.awaits_approval) else { return };
        if let Some(order) = operator.sees(self.frame, job, plan) {
            self.order(order);
        }
    }
}
