//! What a cell knows of its fleet, and the list of what is to be done: shared by the parts that decide.
//!
//! In: the states of the cells, refusals, what persons want. Out: who serves a job, who is away, who is
//! before this cell. Pure.

use crate::payloads::{CellState, Wish};
use crate::subjects::{Key, Target};
use crate::values::{At, Effect};
use cell_values::time::{Duration, Timestamp};
use std::collections::{BTreeMap, VecDeque};

/// The cell, and how patient it is.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Its name.
    pub cell: String,
    /// Its labels.
    pub labels: Vec<String>,
    /// A claim that is not begun goes back after so long.
    pub hold: Duration,
    /// A cell that was silent for so long is away: what it had not begun goes to others, what it had begun
    /// is stranded.
    pub away: Duration,
    /// A message that is not settled goes to another cell after so long.
    pub ack_wait: Duration,
}

impl Settings {
    /// The usual figures.
    pub fn new(cell: &str, labels: &[String]) -> Settings {
        Settings {
            cell: cell.to_string(),
            labels: labels.to_vec(),
            hold: Duration::from_secs(60),
            away: Duration::from_secs(60),
            ack_wait: Duration::from_secs(30),
        }
    }
}

/// A cell as it was seen last.
#[derive(Clone, Debug, PartialEq)]
pub struct KnownCell {
    /// Its state.
    pub state: CellState,
    /// When it was written, by the server's clock.
    pub unix_s: f64,
}

/// What is known. See the module.
pub struct World {
    /// The own cell.
    pub settings: Settings,
    /// The present moment.
    pub at: At,
    /// The server answers.
    pub connected: bool,
    /// Armed, and nothing to do.
    pub ready: bool,
    /// The cells of the fleet as they were last seen: all of them when they were listed or where all are
    /// followed, else this one and the one that is followed.
    pub members: BTreeMap<String, KnownCell>,
    /// Refusals by job and cell: epoch and reason.
    pub refusals: BTreeMap<String, BTreeMap<String, (u32, String)>>,
    /// What persons want, by key.
    pub wishes: BTreeMap<Key, Wish>,
    /// What is to be done.
    pub effects: VecDeque<Effect>,
}

impl World {
    /// Nothing known yet.
    pub fn new(settings: Settings) -> World {
        World {
            settings,
            at: At { now: Timestamp::ZERO, unix_s: 0.0 },
            connected: false,
            ready: false,
            members: BTreeMap::new(),
            refusals: BTreeMap::new(),
            wishes: BTreeMap::new(),
            effects: VecDeque::new(),
        }
    }

    /// Wants something done.
    pub fn want(&mut self, effect: Effect) {
        self.effects.push_back(effect);
    }

    /// A person who does not want the job.
    pub fn cancelled_by(&self, job: &str) -> Option<&str> {
        self.wishes.keys().find_map(|key| match key {
            Key::Cancel { job: of, by } if of == job => Some(by.as_str()),
            _ => None,
        })
    }

    /// Notes a refusal, or that it was taken back.
    pub fn refused(&mut self, job: &str, cell: &str, refusal: Option<(u32, String)>) {
        let of_job = self.refusals.entry(job.to_string()).or_default();
        match refusal {
            Some(refusal) => of_job.insert(cell.to_string(), refusal),
            None => of_job.remove(cell),
        };
        if of_job.is_empty() {
            self.refusals.remove(job);
        }
    }

    /// Each cell's reason, when all that serve the target have refused the job in this epoch. A cell that is
    /// away and has not refused might do it when it is back.
    pub fn all_refused(&self, job: &str, epoch: u32, target: &Target) -> Option<BTreeMap<String, String>> {
        let refusals = self.refusals.get(job)?;
        let settings = &self.settings;
        let own = target.includes(&settings.cell, &settings.labels).then_some(settings.cell.as_str());
        let serving =
            self.members.iter().filter(|(name, member)| target.includes(name, &member.state.labels));
        let mut reasons = BTreeMap::new();
        for cell in serving.map(|(name, _)| name.as_str()).chain(own) {
            let (of, reason) = refusals.get(cell)?;
            if *of != epoch {
                return None;
            }
            reasons.insert(cell.to_string(), reason.clone());
        }
        (!reasons.is_empty()).then_some(reasons)
    }

    /// A cell whose state is old, or of another server, whose clock was ahead.
    pub fn is_away(&self, cell: &str) -> bool {
        self.members.get(cell).is_none_or(|member| self.is_old(member.unix_s))
    }

    fn is_old(&self, unix_s: f64) -> bool {
        (self.at.unix_s - unix_s).abs() > self.settings.away.as_secs_f64()
    }

    /// The first cell that has an earlier name than this one and is not away.
    pub fn before_this(&self) -> Option<String> {
        let own = &self.settings.cell;
        self.members.keys().find(|name| *name < own && !self.is_away(name)).cloned()
    }

    /// The states of all cells. What came of one of them meanwhile is newer, also of one that is not listed.
    pub fn list(&mut self, cells: Vec<(String, CellState, f64)>) {
        let newest = cells.iter().map(|(.., unix_s)| *unix_s).fold(f64::NEG_INFINITY, f64::max);
        let listed = cells.iter().map(|(name, .., unix_s)| (name.clone(), *unix_s));
        let listed: BTreeMap<String, f64> = listed.collect();
        let mut newer = std::mem::take(&mut self.members);
        newer.retain(|name, known| {
            known.unix_s > listed.get(name).copied().unwrap_or(newest) && !self.is_old(known.unix_s)
        });
        self.members =
            cells.into_iter().map(|(name, state, unix_s)| (name, KnownCell { state, unix_s })).collect();
        self.members.extend(newer);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn world(cells: &[(&str, &[&str], f64)]) -> World {
        let mut world = World::new(Settings::new("b", &["line-a".to_string()]));
        world.at.unix_s = 1000.0;
        world.connected = true;
        for (name, labels, unix_s) in cells {
            let labels = labels.iter().map(|label| label.to_string()).collect();
            let state = CellState { labels, ..CellState::default() };
            world.members.insert(name.to_string(), KnownCell { state, unix_s: *unix_s });
        }
        world
    }

    #[test]
    fn a_job_is_refused_by_all_when_each_cell_that_serves_it_has_refused_this_epoch() {
        let mut world = world(&[("a", &["line-a"], 990.0), ("b", &["line-a"], 990.0), ("c", &[], 10.0)]);
        let refused = |epoch: u32| Some((epoch, "no such object".to_string()));
        let of_line = Target::Label("line-a".into());
        world.refused("tidy", "b", refused(1));
        assert_eq!(world.all_refused("tidy", 1, &of_line), None);
        world.refused("tidy", "a", refused(1));
        assert_eq!(world.all_refused("tidy", 1, &of_line).unwrap().len(), 2);
        assert_eq!(world.all_refused("tidy", 2, &of_line), None, "given anew, asked anew");
        assert_eq!(world.all_refused("tidy", 1, &Target::any()), None, "c is away and may do it");
        world.refused("tidy", "a", None);
        assert_eq!(world.all_refused("tidy", 1, &of_line), None, "taken back");
    }

    #[test]
    fn a_list_replaces_what_was_known_but_for_what_is_newer() {
        let known: [(&str, &[&str], f64); 4] =
            [("a", &["newer"], 990.0), ("ahead", &[], 5000.0), ("gone", &[], 970.0), ("new", &[], 999.0)];
        let mut world = world(&known);
        let listed = |name: &str, unix_s| (name.to_string(), CellState::default(), unix_s);
        world.list(vec![listed("a", 980.0), listed("c", 970.0)]);
        assert_eq!(world.members.keys().collect::<Vec<_>>(), ["a", "c", "new"]);
        assert_eq!(world.members["a"].state.labels, ["newer"]);
        assert_eq!(world.before_this().as_deref(), Some("a"));
    }
}
