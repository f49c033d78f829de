//! Which cell looks after all jobs: of the cells that are not away the one with the first name.
//!
//! In: the states of all cells when they were listed, and afterwards that of one cell. Out: whether this
//! cell is it; a list, or the one cell to follow. Who followed all others would get each state of each: with
//! a hundred cells ten thousand messages a second. One cell with an earlier name that is not away is enough:
//! as long as it lives, this cell is not the first. When it goes away the cells are listed anew. So the
//! first of those that live follows no living one, and knows after its next list that it is the first. It
//! follows all cells then, and steps back when one with an earlier name comes. After the server was away for
//! long all states are old: what a cell followed it follows on, and no cell counts as away before it had the
//! time to show itself. Two that believe it of themselves meanwhile do no harm, since all they write is
//! compared and set. Pure.

use crate::values::Effect;
use crate::world::World;
use cell_values::time::{Duration, Timestamp};

/// A list that did not come is requested again after so long.
const LIST_AGAIN: Duration = Duration::from_secs(10);

/// So long after the server is back each cell that lives has shown itself: they do every five seconds.
const SHOWN_BY: Duration = Duration::from_secs(15);

/// What this cell knows of who is before it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Succession {
    place: Place,
    /// Since when the server serves.
    since: Option<Timestamp>,
}

#[derive(Clone, Debug, Default, PartialEq, Eq)]
enum Place {
    /// Not known: there is no list yet.
    #[default]
    Unknown,
    /// A list was requested then.
    Listing(Timestamp),
    /// This cell has an earlier name and is not away.
    Behind(String),
    /// No cell is before this one.
    First,
}

impl Succession {
    /// The connection is another one: what was followed ended with it.
    pub fn reconnected(&mut self) {
        self.since = None;
        if !matches!(self.place, Place::Behind(_)) {
            self.place = Place::Unknown;
        }
    }

    /// Looks at what has changed; true for the cell that looks after all jobs.
    pub fn turn(&mut self, world: &mut World) -> bool {
        if !world.connected {
            self.reconnected();
            return false;
        }
        if self.since.is_none() {
            self.since = Some(world.at.now);
            if let Place::Behind(name) = &self.place {
                world.want(Effect::Watch(Some(name.clone())));
            }
        }
        match &self.place {
            Place::Unknown => self.list(world),
            Place::Listing(since) if world.at.now.since(*since) >= LIST_AGAIN => self.list(world),
            Place::Behind(name) if self.is_settled(world) && world.is_away(name) => {
                world.want(Effect::Watch(None));
                self.list(world);
            }
            Place::Listing(_) | Place::Behind(_) => {}
            Place::First => {
                if let Some(name) = world.before_this() {
                    self.behind(world, name);
                }
            }
        }
        self.place == Place::First
    }

    /// All cells were listed; false when they could not be.
    pub fn listed(&mut self, world: &mut World, complete: bool) {
        if !complete || !matches!(self.place, Place::Listing(_)) {
            return;
        }
        let earlier = world.members.keys().find(|name| **name < world.settings.cell).cloned();
        match world.before_this().or(earlier.filter(|_| !self.is_settled(world))) {
            Some(name) => self.behind(world, name),
            None => self.place = Place::First,
        }
    }

    fn is_settled(&self, world: &World) -> bool {
        self.since.is_some_and(|since| world.at.now.since(since) >= SHOWN_BY)
    }

    fn list(&mut self, world: &mut World) {
        self.place = Place::Listing(world.at.now);
        world.want(Effect::List);
    }

    fn behind(&mut self, world: &mut World, name: String) {
        world.want(Effect::Watch(Some(name.clone())));
        self.place = Place::Behind(name);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::payloads::CellState;
    use crate::world::{KnownCell, Settings};

    fn world(cells: &[(&str, f64)]) -> World {
        let mut world = World::new(Settings::new("b", &[]));
        (world.connected, world.at.unix_s) = (true, 1000.0);
        for (name, unix_s) in cells {
            let known = KnownCell { state: CellState::default(), unix_s: *unix_s };
            world.members.insert(name.to_string(), known);
        }
        world
    }

    fn wanted(world: &mut World) -> Vec<Effect> {
        world.effects.drain(..).collect()
    }

    #[test]
    fn the_first_that_is_not_away_is_it_once_it_has_a_list() {
        for (cells, first) in [
            (vec![], true),
            (vec![("c", 999.0)], true),
            (vec![("a", 900.0), ("c", 999.0)], true),
            (vec![("a", 999.0)], false),
            (vec![("a", 999.0), ("aa", 900.0)], false),
        ] {
            let (mut world, mut of) = (world(&cells), Succession::default());
            assert!(!of.turn(&mut world), "not before there is a list");
            world.at.now += SHOWN_BY;
            assert_eq!(wanted(&mut world), [Effect::List]);
            of.listed(&mut world, false);
            assert!(!of.turn(&mut world), "a list that did not come says nothing");
            wanted(&mut world);
            of.listed(&mut world, true);
            assert_eq!(of.turn(&mut world), first, "{cells:?}");
            let follows: Vec<Effect> =
                if first { vec![] } else { vec![Effect::Watch(Some("a".to_string()))] };
            assert_eq!(wanted(&mut world), follows, "{cells:?}");
        }
    }

    #[test]
    fn it_steps_back_behind_an_earlier_cell_and_follows_when_that_is_away() {
        let (mut world, mut of) = (world(&[]), Succession::default());
        of.turn(&mut world);
        of.listed(&mut world, true);
        assert!(of.turn(&mut world));
        world.members.insert("a".into(), KnownCell { state: CellState::default(), unix_s: 999.0 });
        assert!(!of.turn(&mut world));
        assert_eq!(wanted(&mut world), [Effect::List, Effect::Watch(Some("a".to_string()))]);
        world.at.unix_s = 1100.0;
        assert!(!of.turn(&mut world) && wanted(&mut world).is_empty(), "the server has just come");
        world.at.now += SHOWN_BY;
        assert!(!of.turn(&mut world), "who else is before it has to be seen first");
        assert_eq!(wanted(&mut world), [Effect::Watch(None), Effect::List]);
        of.listed(&mut world, true);
        assert!(of.turn(&mut world));
    }

    #[test]
    fn a_list_that_does_not_come_is_requested_again_and_without_a_connection_no_cell_is_it() {
        let (mut world, mut of) = (world(&[]), Succession::default());
        of.turn(&mut world);
        world.at.now += LIST_AGAIN;
        of.turn(&mut world);
        assert_eq!(wanted(&mut world), [Effect::List, Effect::List]);
        of.listed(&mut world, true);
        assert!(of.turn(&mut world));
        world.connected = false;
        assert!(!of.turn(&mut world));
    }

    #[test]
    fn after_a_long_absence_of_the_server_it_follows_on_until_the_others_had_time_to_show_themselves() {
        for listed_before in [true, false] {
            let (mut world, mut of) = (world(&[("a", 999.0)]), Succession::default());
            if listed_before {
                of.turn(&mut world);
                of.listed(&mut world, true);
            }
            (world.connected, world.at.unix_s) = (false, 2000.0);
            of.turn(&mut world);
            wanted(&mut world);
            world.connected = true;
            assert!(!of.turn(&mut world));
            of.listed(&mut world, true);
            assert!(!of.turn(&mut world), "all states are old");
            let list = (!listed_before).then_some(Effect::List);
            let follow = Effect::Watch(Some("a".to_string()));
            assert_eq!(wanted(&mut world), list.into_iter().chain([follow]).collect::<Vec<_>>());
            world.at.now += SHOWN_BY;
            of.turn(&mut world);
            of.listed(&mut world, true);
            assert!(of.turn(&mut world), "a has not come back");
        }
    }
}
