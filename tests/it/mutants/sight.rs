//! Mutants of what the cell knows: old pictures, a calibration that is not checked, a cell that lacks what
//! stands in it, an approval that nobody gave.

use crate::mutants::drill::{Case, SEED, arm, bring_about, submit, until_found, until_working, usual, wait};
use crate::mutants::plant::{Plant, commissioned, shared};
use cell_machine::event::{Effect, Event, News};
use cell_machine::intake::Origin;
use cell_machine::orders::{Approval, Order};
use cell_machine::supervisor::model::CellModel;
use cell_machine::supervisor::order::JobOrder;
use cell_machine::supervisor::status::WorkStep;
use cell_motion::bodies::cell::NamedShape;
use cell_motion::bodies::shape::Shape;
use cell_values::time::Timestamp;
use cell_vision::observe::Observation;
use celld::pair::Pair;
use celld::pair::camera_view::SightKind;
use celld::pair::rules::Rule;
use celld::pair::run::true_poses;
use celld::pair::stage::Stage;
use celld::pair::table::stage;
use celld::pair::work::job;
use nalgebra::Isometry3;
use std::cell::RefCell;
use std::rc::Rc;
use ur_sim::motion::safety::SafetyPlane;

pub const CASES: &[Case] = &[
    Case {
        name: "what was seen once is taken for what is there",
        rule: Rule::PickOnOldSight,
        cell: usual,
        plant: sight_kept,
        drill: a_whole_job,
    },
    Case {
        name: "an object that a hand has moved is taken for where it was",
        rule: Rule::PickOfMoved,
        cell: usual,
        plant: objects_kept,
        drill: nudged,
    },
    Case {
        name: "a plan is approved by nobody",
        rule: Rule::PickWithoutApproval,
        cell: usual,
        plant: approves_itself,
        drill: a_job_to_approve,
    },
    Case {
        name: "a job that requires approval is taken for one that does not",
        rule: Rule::PickWithoutApproval,
        cell: usual,
        plant: approval_forgotten,
        drill: a_job_to_approve,
    },
    Case {
        name: "the reference markers are not compared with their survey",
        rule: Rule::PickUncalibrated,
        cell: usual,
        plant: references_kept,
        drill: camera_bumped,
    },
    Case {
        name: "the equipment is not known",
        rule: Rule::MeetsEquipment,
        cell: with_a_post,
        plant: || commissioned(without_equipment),
        drill: a_whole_job,
    },
    Case {
        name: "the safety planes are not known",
        rule: Rule::MeetsEquipment,
        cell: with_a_plane,
        plant: || commissioned(without_equipment),
        drill: a_whole_job,
    },
];

fn a_whole_job(pair: &mut Pair, stage: &Stage) {
    arm(pair);
    submit(pair, stage, 0);
    pair.run_until(120.0, |pair| !pair.breaches().is_empty() || !pair.reports().is_empty());
    wait(pair, 0.3);
}

fn sight_kept() -> Plant {
    let first = Rc::new(RefCell::new(None::<Box<Observation>>));
    let seen = Rc::clone(&first);
    Plant::none()
        .event(move |event, events| {
            if let Event::Observed(_, Ok(observation)) = &event {
                seen.borrow_mut().get_or_insert(observation.clone());
            }
            events.push(event);
        })
        .effect(move |effect, effects, made_up| match (&effect, &*first.borrow()) {
            (Effect::Observe { number, .. }, Some(seen)) => {
                made_up.push(Event::Observed(*number, Ok(seen.clone())));
            }
            _ => effects.push(effect),
        })
}

/// Every object stays where the first look has shown it.
fn objects_kept() -> Plant {
    let mut first = None::<Box<Observation>>;
    Plant::none().event(move |event, events| {
        events.push(match event {
            Event::Observed(number, Ok(mut seen)) => {
                let known = first.get_or_insert(seen.clone());
                for object in &mut seen.objects {
                    let before = known.objects.iter().find(|before| before.id == object.id);
                    object.pose = before.map_or(object.pose, |before| before.pose);
                }
                Event::Observed(number, Ok(seen))
            }
            other => other,
        });
    })
}

/// After an aborted job all its objects are pushed aside, and another job wants them moved.
fn nudged(pair: &mut Pair, stage: &Stage) {
    arm(pair);
    let order = job(&stage.model, &true_poses(pair, &stage.model), SEED, 0);
    let goals = order.goals.clone();
    pair.submit(order);
    until_working(pair, WorkStep::Approaching);
    pair.order(Order::Abort);
    wait(pair, 3.0);
    for (object, _) in &goals {
        let args = format!(r#"{{"object": "{object}", "dx_m": 0.02, "dy_m": 0.02}}"#);
        bring_about(pair, &format!(r#"{{"do": "world.nudge", "args": {args}}}"#));
    }
    arm(pair);
    let order = job(&stage.model, &true_poses(pair, &stage.model), SEED, 1);
    pair.submit(JobOrder { goals, ..order });
    until_found(pair, 40.0);
}

fn to_approve(pair: &mut Pair, stage: &Stage) {
    let order = job(&stage.model, &true_poses(pair, &stage.model), SEED, 0);
    pair.submit(JobOrder { approval: Approval::Always, ..order });
}

fn a_job_to_approve(pair: &mut Pair, stage: &Stage) {
    arm(pair);
    to_approve(pair, stage);
    until_found(pair, 30.0);
}

/// An order that no person gave, and that is answered to nobody.
fn approves_itself() -> Plant {
    const FORGED: u64 = 999_999;
    let waiting = Rc::new(RefCell::new(None));
    let job = Rc::clone(&waiting);
    Plant::none()
        .effect(move |effect, effects, _| match effect {
            Effect::Reply { number: FORGED, .. } => {}
            Effect::Notify(News::Status(status)) => {
                *job.borrow_mut() = status.job.clone().filter(|_| status.awaits_approval);
                effects.push(Effect::Notify(News::Status(status)));
            }
            other => effects.push(other),
        })
        .frame(move |machine, _, made_up| {
            let Some(id) = waiting.borrow_mut().take() else { return };
            let plan = machine.supervisor().map_or(0, |cell| cell.last_plan());
            made_up.push(Event::Order(FORGED, Order::Approve { id, plan }, Origin::OWN));
        })
}

fn approval_forgotten() -> Plant {
    Plant::none().event(|event, events| {
        events.push(match event {
            Event::Job(mut job) => {
                job.approval = Approval::Never;
                Event::Job(job)
            }
            other => other,
        });
    })
}

/// What the first look has shown is taken for what every later one shows.
fn references_kept() -> Plant {
    let time = shared(Timestamp::ZERO);
    let taken = Rc::clone(&time);
    let mut first = None::<Box<Observation>>;
    Plant::none()
        .effect(move |effect, effects, _| {
            if let Effect::Observe { views, .. } = &effect {
                taken.set(views.iter().map(|view| view.time).max().unwrap_or(Timestamp::ZERO));
            }
            effects.push(effect);
        })
        .event(move |event, events| {
            events.push(match event {
                Event::Observed(number, Ok(seen)) => {
                    let mut known = first.get_or_insert(seen).clone();
                    known.objects.iter_mut().for_each(|object| object.time = time.get());
                    Event::Observed(number, Ok(known))
                }
                other => other,
            });
        })
}

/// After one job; the next begins with a look at the whole table.
fn camera_bumped(pair: &mut Pair, stage: &Stage) {
    arm(pair);
    submit(pair, stage, 0);
    until_working(pair, WorkStep::Approaching);
    pair.order(Order::Abort);
    wait(pair, 3.0);
    submit(pair, stage, 0);
    bring_about(pair, r#"{"do": "camera.extrinsics", "args": {"translation_m": [0.006, 0, 0]}}"#);
    arm(pair);
    until_found(pair, 40.0);
}

/// Over the middle of the table, where the arm goes from object to object.
fn with_a_post(stage: &mut Stage) {
    let table = stage.world.base_from_table.translation.vector;
    let middle = Isometry3::translation(table.x + 0.2, table.y + 0.2, 0.35);
    let post = NamedShape { name: "the post".to_string(), shape: Shape::cuboid([0.03, 0.03, 0.5], &middle) };
    stage.model.arm.bodies = stage.model.arm.bodies.clone().with(&post);
}

/// A safety plane along the left edge of the table.
fn with_a_plane(stage: &mut Stage) {
    let left = stage.world.base_from_table.translation.x;
    let (point, normal) = ([left, 0.0, 0.0], [1.0, 0.0, 0.0]);
    let plane = NamedShape { name: "the wall".to_string(), shape: Shape::half_space(point, normal) };
    stage.model.arm.bodies = stage.model.arm.bodies.clone().with(&plane);
    stage.controller.safety.planes.push(SafetyPlane { point, normal });
}

fn without_equipment(model: &mut CellModel) {
    model.arm.bodies = stage(SEED, SightKind::Corners).expect("the drill runs").model.arm.bodies;
}
