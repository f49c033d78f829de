//! Jobs while the shell around the machine is disturbed: the process stands still or is ordered to end, the
//! folder of commands is gone or full of a script's orders, the disk stalls, the calendar jumps, and people
//! give orders and leave.
//!
//! In: a seed. Out: what must not be, in words. The rules of the closed loop watch what they always watch,
//! and that each order is decided in time or not at all.

use crate::jobs::command::{Command, ReleaseChannel};
use crate::pair::disk::Mood;
use crate::pair::run::{bring_up, true_poses};
use crate::pair::shell::folder::Fate;
use crate::pair::shell::{Client, Leaves, Way};
use crate::pair::stage::Stage;
use crate::pair::sweep::{after, settled};
use crate::pair::work::approved_job;
use crate::pair::{Choice, Loss, Pair};
use cell_machine::orders::{Order, WayBack};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use ur_sim::motion::FRAME_SECONDS;

/// Seconds after arming within which something happens.
const WITHIN_S: f64 = 25.0;

/// Simulated seconds for the job to end, or to wait for a person.
const END_WITHIN_S: f64 = 240.0;

/// A client takes its order back after so long, as `celld` does, s.
const PATIENCE_S: f64 = 10.0;

/// Seconds that celld may take to end: 6 for arm and gripper, 15 for the disk.
const ENDS_WITHIN_S: f64 = 22.0;

/// The longest standstill of the process, s: an order to end waits until it is over.
const STANDS_STILL_MAX_S: f64 = 20.0;

/// Seconds from one calendar to the other when it is set.
const TEN_YEARS_S: f64 = 3.2e8;

/// What disturbs the shell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Disturbance {
    /// The process stands still, s.
    StandsStill(f64),
    /// The folder of commands is like this, for so long, s.
    Folder(Fate, f64),
    /// So many files lie in it at once.
    Flood(u32),
    /// So many viewers pause at the page at once.
    Viewers(u32),
    /// A commit takes so long, for so long, s; zero: the disk is as it was.
    Disk(f64),
    /// The calendar is set by so much, s.
    Calendar(f64),
    /// celld is ordered to end, and is started again.
    Ends,
}

fn disturbance(rng: &mut impl Rng) -> Disturbance {
    match rng.random_range(0..9) {
        8 => Disturbance::Ends,
        0 => Disturbance::StandsStill(rng.random_range(0.05..1.0)),
        1 => Disturbance::StandsStill(rng.random_range(1.0..STANDS_STILL_MAX_S)),
        2 => Disturbance::Folder(Fate::Gone, rng.random_range(0.1..5.0)),
        3 => Disturbance::Folder(Fate::Unreadable, rng.random_range(0.1..5.0)),
        4 => Disturbance::Flood(rng.random_range(10..1000)),
        5 => Disturbance::Viewers(rng.random_range(10..200)),
        6 => Disturbance::Disk(rng.random_range(0.1..5.0)),
        _ => Disturbance::Calendar(if rng.random_bool(0.5) { TEN_YEARS_S } else { -TEN_YEARS_S }),
    }
}

/// A random order. A release is of channel B only, because releasing both would drop the held object.
fn command(rng: &mut impl Rng, job: &str) -> Command {
    match rng.random_range(0..10) {
        0..=2 => Command::Arm,
        3 => Command::Disarm,
        4 => Command::Pause,
        5 => Command::Resume,
        6 => Command::Step,
        7 => Command::Abort,
        8 => Command::Park,
        _ if rng.random_bool(0.3) => Command::Recover { how: WayBack::Show },
        _ if rng.random_bool(0.3) => Command::Release { channel: Some(ReleaseChannel::B) },
        _ => Command::Cancel { id: job.to_string() },
    }
}

fn client(rng: &mut impl Rng, gives_at: u64, job: &str) -> Client {
    let way = match rng.random_range(0..3) {
        0 => Way::Page(format!("person {}", rng.random_range(1..4))),
        _ => Way::File,
    };
    let leaves = match rng.random_range(0..4) {
        0 => Leaves::GivesUp(rng.random_range(0.0..3.0)),
        1 => Leaves::Killed(rng.random_range(0.0..3.0)),
        _ => Leaves::GivesUp(PATIENCE_S),
    };
    Client::new(command(rng, job), way, gives_at, leaves)
}

/// What happens, with its moments after arming, s.
pub fn disturbances(seed: u64) -> Vec<(f64, Disturbance)> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x7368_656c);
    let count = rng.random_range(1..=4);
    let one = |rng: &mut ChaCha8Rng| (rng.random_range(0.0..WITHIN_S), disturbance(rng));
    let mut all: Vec<_> = (0..count).map(|_| one(&mut rng)).collect();
    all.sort_by(|a, b| a.0.total_cmp(&b.0));
    all
}

/// Brings it about; what must not be.
fn bring_about(
    pair: &mut Pair,
    disturbance: Disturbance,
    ends: &mut Vec<(f64, Disturbance)>,
) -> Result<(), String> {
    let (now_s, frame) = (pair.seconds(), (pair.seconds() / FRAME_SECONDS) as u64);
    match disturbance {
        Disturbance::StandsStill(seconds) => pair.stand_still(seconds),
        Disturbance::Folder(fate, seconds) => {
            pair.shell().folder_is(fate);
            if fate != Fate::Sound {
                ends.push((now_s + seconds, Disturbance::Folder(Fate::Sound, 0.0)));
            }
        }
        Disturbance::Flood(count) => pair.shell().flood(frame, count),
        Disturbance::Viewers(count) => (0..count).for_each(|viewer| {
            let way = Way::Page(format!("viewer {}", viewer % 100));
            pair.shell().add(Client::new(Command::Pause, way, frame, Leaves::GivesUp(PATIENCE_S)));
        }),
        Disturbance::Disk(0.0) => pair.disk().mood = Mood::Fine,
        Disturbance::Disk(seconds) => {
            pair.disk().mood = Mood::Slow(seconds);
            ends.push((now_s + seconds, Disturbance::Disk(0.0)));
        }
        Disturbance::Calendar(by_s) => pair.shell().calendar_jumps(by_s),
        Disturbance::Ends => return ends_and_starts(pair),
    }
    Ok(())
}

/// Ordered to end, celld brings the arm to rest. The rules watch the vacuum.
fn ends_and_starts(pair: &mut Pair) -> Result<(), String> {
    pair.terminate();
    let ended = pair.run_until(STANDS_STILL_MAX_S + ENDS_WITHIN_S, |pair| pair.ended().is_some());
    let rests = pair.simulator().core().robot.controller().core.mover.stands();
    pair.restart(Loss::Killed).map_err(|error| error.to_string())?;
    match ended {
        false => Err(format!("celld has not ended after {ENDS_WITHIN_S} s")),
        true if !rests => Err("celld ended while the arm moved".to_string()),
        true => Ok(()),
    }
}

/// Orders wait while this lasts.
fn cuts_off(disturbance: &Disturbance) -> bool {
    matches!(disturbance, Disturbance::StandsStill(_) | Disturbance::Folder(..) | Disturbance::Ends)
}

/// Its order is answered at once, it has waited its full patience, and there was no answer.
fn has_no_answer(client: &Client) -> bool {
    let at_once = matches!(client.command, Command::Arm | Command::Resume | Command::Cancel { .. });
    let (given, left) = (client.given_in().unwrap_or_default(), client.left_in().unwrap_or_default());
    at_once && !client.is_done() && (left - given) as f64 * FRAME_SECONDS > PATIENCE_S - 0.1
}

/// A job beside these disturbances and orders, and the job after it: what must not be, and the loop with its
/// trace, where that is kept.
///
/// # Errors
/// The loop cannot be set up.
pub fn shell_job(stage: &Stage, seed: u64, keep: bool) -> Result<(Vec<String>, Pair), String> {
    let choice = Choice { keep_trace: keep, ..Choice::of(seed) };
    let mut pair = Pair::new(stage.clone(), choice).map_err(|error| error.to_string())?;
    if !bring_up(&mut pair) {
        return Ok((vec!["the cell does not come up".to_string()], pair));
    }
    pair.order(Order::Arm);
    pair.approve_plans();
    let job = approved_job(&stage.model, &true_poses(&pair, &stage.model), seed, 0);
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x6f72_6465);
    let began = pair.seconds();
    for _ in 0..rng.random_range(2..=8) {
        let at = ((began + rng.random_range(0.0..WITHIN_S)) / FRAME_SECONDS) as u64;
        let client = client(&mut rng, at, &job.id);
        pair.shell().add(client);
    }
    pair.submit(job);
    let mut faults = Vec::new();
    let mut coming: Vec<_> = disturbances(seed).into_iter().map(|(at, one)| (began + at, one)).collect();
    while !coming.is_empty() {
        coming.sort_by(|a, b| b.0.total_cmp(&a.0));
        let Some((at_s, next)) = coming.pop() else { break };
        let left_s = at_s - pair.seconds();
        pair.run_until(left_s.max(0.0), |_| false);
        faults.extend(bring_about(&mut pair, next, &mut coming).err());
    }
    pair.run_until(WITHIN_S + PATIENCE_S, |_| false);
    pair.run_until(END_WITHIN_S, |pair| settled(pair, 0));
    if after(&mut pair, stage, seed).is_none() {
        faults.push("the job after it has not ended".to_string());
    }
    let reached = !disturbances(seed).iter().any(|(_, one)| cuts_off(one));
    let clients = pair.shell().clients();
    let lost = clients.iter().filter(|client| reached && has_no_answer(client));
    faults.extend(lost.map(|client| format!("{:?} has no answer", client.command)));
    faults.extend(pair.breaches().iter().map(|breach| format!("{:?}: {}", breach.rule, breach.detail)));
    Ok((faults, pair))
}
