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

/// The own state reaches the server before the first list: without it a list is none.
const FIRST_LIST: Duration = Duration::from_secs(1);

/// A list that could not be read is requested again after so long.
const LIST_AGAIN: Duration = Duration::from_secs(2);

/// A list that was not answered by then is lost.
const LIST_LOST: Duration = Duration::from_secs(20);

/// After so many lists that could not be read this cell looks after the jobs until it has one: another one
/// that does so too does no harm, and none would.
const LISTS_MOST: u32 = 3;

/// So long after the server is back each cell that lives has shown itself: they do every five seconds.
const SHOWN_BY: Duration = Duration::from_secs(15);

/// What this cell knows of who is before it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Succession {
    place: Place,
    /// When the next list is due.
    due: Timestamp,
    /// Lists that could not be read, one after the other.
    failed: u32,
    /// Since when cells can show themselves.
    since: Option<Timestamp>,
    /// Since when the server is away.
    gone: Option<Timestamp>,
    /// What is followed is followed over the present connection.
    follows: bool,
}

#[derive(Clone, Debug, Default, PartialEq, Eq)]
enum Place {
    /// Not known: a list is due.
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
    /// The connection is another one, or gone: what was followed ended with it.
    pub fn reconnected(&mut self, world: &World) {
        (self.follows, self.failed) = (false, 0);
        self.due = world.at.now + FIRST_LIST;
        if !matches!(self.place, Place::Behind(_)) {
            self.place = Place::Unknown;
        }
    }

    /// Looks at what has changed; true for the cell that looks after all jobs.
    pub fn turn(&mut self, world: &mut World) -> bool {
        let now = world.at.now;
        if !world.connected {
            self.gone.get_or_insert(now);
            self.reconnected(world);
            return false;
        }
        let was_long = self.gone.take().is_some_and(|gone| now.since(gone) >= SHOWN_BY);
        if was_long || self.since.is_none() {
            self.since = Some(now);
        }
        match &self.place {
            Place::Unknown if now >= self.due => self.list(world),
            Place::Listing(since) if now.since(*since) >= LIST_LOST => self.unlisted(world),
            Place::Unknown | Place::Listing(_) => {}
            Place::Behind(name) if self.is_settled(world) && world.is_away(name) => {
                world.want(Effect::Watch(None));
                self.list(world);
            }
            Place::Behind(name) if !self.follows => self.behind(world, name.clone()),
            Place::Behind(_) => {}
            Place::First => {
                if let Some(name) = world.before_this() {
                    self.behind(world, name);
                }
            }
        }
        self.place == Place::First || self.failed >= LISTS_MOST
    }

    /// All cells were listed; false when they could not be.
    pub fn listed(&mut self, world: &mut World, complete: bool) {
        if !matches!(self.place, Place::Listing(_)) {
            return;
        }
        if !complete {
            return self.unlisted(world);
        }
        if std::mem::take(&mut self.failed) > 0 {
            // Who could not be listed could not show itself either.
            self.since = Some(world.at.now);
        }
        let earlier = world.members.keys().find(|name| **name < world.settings.cell).cloned();
        match world.before_this().or(earlier.filter(|_| !self.is_settled(world))) {
            Some(name) => self.behind(world, name),
            None => self.place = Place::First,
        }
    }

    /// Each cell that lives had the time to show itself.
    pub fn is_settled(&self, world: &World) -> bool {
        self.since.is_some_and(|since| world.at.now.since(since) >= SHOWN_BY)
    }

    fn list(&mut self, world: &mut World) {
        self.place = Place::Listing(world.at.now);
        world.want(Effect::List);
    }

    fn unlisted(&mut self, world: &World) {
        self.failed = self.failed.saturating_add(1);
        self.due = world.at.now + LIST_AGAIN;
        self.place = Place::Unknown;
    }

    fn behind(&mut self, world: &mut World, name: String) {
        (self.follows, self.failed) = (true, 0);
        world.want(Effect::Watch(Some(name.clone())));
        self.place = Place::Behind(name);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::payloads::CellState;
    use crate::world::{KnownCell, Settings};

    fn known(unix_s: f64) -> KnownCell {
        KnownCell { state: CellState::default(), unix_s }
    }

    fn world(cells: &[(&str, f64)]) -> World {
        let mut world = World::new(Settings::new("b", &[]));
        (world.connected, world.at.unix_s) = (true, 1000.0);
        world.members = cells.iter().map(|(name, unix_s)| (name.to_string(), known(*unix_s))).collect();
        world
    }

    fn wanted(world: &mut World) -> Vec<Effect> {
        world.effects.drain(..).collect()
    }

    fn watch(name: &str) -> Effect {
        Effect::Watch(Some(name.to_string()))
    }

    /// Connected for so long that all who live have shown themselves, and a list is on its way.
    fn listing(cells: &[(&str, f64)]) -> (World, Succession) {
        let (mut world, mut of) = (world(cells), Succession::default());
        of.reconnected(&world);
        assert!(!of.turn(&mut world) && wanted(&mut world).is_empty(), "the own state is on its way");
        world.at.now += SHOWN_BY;
        assert!(!of.turn(&mut world), "not before there is a list");
        assert_eq!(wanted(&mut world), [Effect::List]);
        (world, of)
    }

    #[test]
    fn the_first_that_is_not_away_is_it_once_it_has_a_list() {
        let alive = 999.0;
        for (cells, first) in [
            (vec![], true),
            (vec![("c", alive)], true),
            (vec![("a", 900.0), ("c", alive)], true),
            // Of another server, whose clock was ahead.
            (vec![("a", 5000.0)], true),
            (vec![("a", alive)], false),
            (vec![("a", alive), ("aa", 900.0)], false),
        ] {
            let (mut world, mut of) = listing(&cells);
            of.listed(&mut world, true);
            assert_eq!(of.turn(&mut world), first, "{cells:?}");
            let follows = if first { vec![] } else { vec![watch("a")] };
            assert_eq!(wanted(&mut world), follows, "{cells:?}");
        }
    }

    #[test]
    fn it_steps_back_behind_an_earlier_cell_and_lists_when_that_is_away() {
        let (mut world, mut of) = listing(&[]);
        of.listed(&mut world, true);
        assert!(of.turn(&mut world));
        world.members.insert("a".into(), known(999.0));
        assert!(!of.turn(&mut world));
        assert_eq!(wanted(&mut world), [watch("a")]);
        world.at.unix_s = 1100.0;
        assert!(!of.turn(&mut world), "who else is before it has to be seen first");
        assert_eq!(wanted(&mut world), [Effect::Watch(None), Effect::List]);
        of.listed(&mut world, true);
        assert!(of.turn(&mut world));
    }

    #[test]
    fn a_list_that_does_not_come_is_requested_again_and_after_some_of_them_it_is_the_first() {
        let (mut world, mut of) = listing(&[("a", 999.0)]);
        world.at.now += LIST_LOST;
        assert!(!of.turn(&mut world));
        for _ in 1..LISTS_MOST {
            assert!(!of.turn(&mut world) && wanted(&mut world).is_empty(), "not at once");
            world.at.now += LIST_AGAIN;
            assert!(!of.turn(&mut world));
            assert_eq!(wanted(&mut world), [Effect::List]);
            of.listed(&mut world, false);
        }
        assert!(of.turn(&mut world), "no cell else may be able to list");
        world.at.now += LIST_AGAIN;
        assert!(of.turn(&mut world), "as long as there is no list");
        of.listed(&mut world, true);
        assert!(!of.turn(&mut world), "and a is before it");
        assert_eq!(wanted(&mut world), [Effect::List, watch("a")]);
        world.connected = false;
        assert!(!of.turn(&mut world), "nor is it without a server");
    }

    #[test]
    fn after_a_long_absence_of_the_server_it_follows_on_until_the_others_had_time_to_show_themselves() {
        for listed_before in [true, false] {
            let (mut world, mut of) = listing(&[("a", 999.0)]);
            if listed_before {
                of.listed(&mut world, true);
            }
            wanted(&mut world);
            (world.connected, world.at.unix_s) = (false, 2000.0);
            of.turn(&mut world);
            world.at.now += SHOWN_BY;
            world.connected = true;
            of.turn(&mut world);
            world.at.now += FIRST_LIST;
            of.turn(&mut world);
            of.listed(&mut world, true);
            assert!(!of.turn(&mut world), "all states are old");
            let list = (!listed_before).then_some(Effect::List);
            assert_eq!(wanted(&mut world), list.into_iter().chain([watch("a")]).collect::<Vec<_>>());
            world.at.now += SHOWN_BY;
            of.turn(&mut world);
            of.listed(&mut world, true);
            assert!(of.turn(&mut world), "a has not come back");
        }
    }

    #[test]
    fn a_connection_that_comes_and_goes_does_not_keep_a_dead_cell_first() {
        let (mut world, mut of) = listing(&[("a", 999.0)]);
        of.listed(&mut world, true);
        of.turn(&mut world);
        world.at.unix_s = 1100.0;
        let mut lists = 0;
        for _ in 0..10 {
            world.connected = false;
            of.turn(&mut world);
            world.connected = true;
            world.at.now += LIST_AGAIN;
            of.turn(&mut world);
            lists += wanted(&mut world).iter().filter(|effect| **effect == Effect::List).count();
        }
        assert!(lists > 0, "{of:?}");
    }
}
