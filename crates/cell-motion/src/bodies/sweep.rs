//! The swept check: no two bodies of the cell come nearer than they may, anywhere on a path.
//!
//! In: the bodies, the room, pieces of a path that are straight in joint space. Out: nothing, or the first
//! pair that comes too near, and where. Pure.
//!
//! It is conservative by bounds on motion, not by dense sampling: after a pair was measured, neither of its
//! bodies can meet the other before their joints have turned so far that, at the longest lever each joint
//! has on them, the distance is used up, nor before they have come so much nearer along the line between
//! them (`nearing`). Each pair is measured again only then. Unused distance carries over to the next
//! piece. The method is conservative advancement: Mirtich, "Impulse-based dynamic simulation of rigid body
//! systems", 1996, section 2.3.

use crate::bodies::nearing::{Nearing, Twist, bend};
use crate::bodies::shape::{apart, apart_from, depth_is_known, surely_apart};
use crate::bodies::{Bodies, Body, Other, Pair, Part, Room, against, chains};
use cell_values::units::Joints;
use parry3d_f64::math::{Pose, Vector};

/// The least motion that a measured pair is given before it is measured again, m. Between two measurements
/// it may be nearer than its margin by as much.
const GRAIN_M: f64 = 5e-4;

/// Distances beyond this are taken from the spheres round the bodies, m.
const FAR_M: f64 = 0.05;

/// Pairs that are due within this share of a piece are measured together: the arm's frames cost as much as
/// a few distances.
const TOGETHER: f64 = 0.2;

/// A pair that has to be measured, from this share of a piece on.
struct Due {
    share: f64,
    index: usize,
}

/// Where the arm is: its frames, how they move there, and the middles of all that moves with them, in the
/// base frame.
#[derive(Default)]
struct Place {
    frames: [Pose; 8],
    twists: [Twist; 8],
    middles: Vec<Vector>,
}

/// What a group of pairs has in common: its levers, and what these make of the present piece.
struct Group {
    levers: [f64; 6],
    /// Metres that two bodies with these levers move against each other at most on the whole piece.
    travel: f64,
    /// How much a velocity changes on the straight way, m.
    bend: f64,
    /// How far the curve may be off the straight way, and how fast it gets there, m: four times the bulge.
    aside: f64,
}

/// Distances that are lowered because the arm rests nearer are lowered to this at least, m: what is nearer
/// may touch, and a path that begins where another ended does not come nearer each time.
const LEAST_M: f64 = 2e-3;

/// How far joints are at most off the straight way of a piece, rad: in its middle, less towards its ends.
pub type Bulge = [f64; 6];

/// The bulge of ways that are straight in joint space.
pub const STRAIGHT: Bulge = [0.0; 6];

/// Metres that two bodies with these levers move against each other at most while the joints turn so far,
/// rad.
fn travel(levers: &[f64; 6], turn: &[f64; 6]) -> f64 {
    turn.iter().zip(levers).map(|(turn, lever)| turn * lever).sum()
}

/// Where the tool moves, which decides what is taken to be on the table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Zone {
    /// Over everything that may lie there.
    Over = 0,
    /// Straight down or up between the objects: each is kept clear of, but by cups and load, whose outlines
    /// the plan keeps apart from every other, and who touch what is picked.
    Between = 1,
    /// Where a corner between the two is cut: over everything too, with less air, and clear of what is
    /// known to be higher than that.
    Corner = 2,
}

/// Two bodies too near to each other.
#[derive(Clone, Debug, PartialEq)]
pub struct Meeting {
    /// One of them.
    pub one: String,
    /// The other.
    pub other: String,
    /// Their distance, m; not positive where they overlap.
    pub distance: f64,
    /// Joints there.
    pub at: Joints,
}

impl Group {
    /// At the start of a piece on which the joints go `way` (rad), so far off it at most as `bulge` says.
    fn set_out(&mut self, way: &[f64; 6], bulge: &Bulge) {
        // Off the straight way by 4 s (1 - s) of the bulge at a share s of it, which adds to the motion.
        self.aside = 4.0 * travel(&self.levers, bulge);
        self.travel = travel(&self.levers, &way.map(f64::abs)) + self.aside;
        self.bend = bend(&self.levers, way);
    }
}

/// A check under way along a path.
pub struct Sweep<'a> {
    bodies: &'a Bodies,
    room: &'a Room,
    /// The pairs of this room, after those of `bodies`.
    pairs: Vec<Pair>,
    /// Metres that each pair may still move against each other before it is measured again.
    left: Vec<f64>,
    /// Which pairs are kept apart in each zone.
    watched: [Vec<bool>; 3],
    /// Pairs with the same levers, and to which group each pair belongs.
    groups: Vec<Group>,
    group_of: Vec<usize>,
    /// For each pair the direction in which the one body was seen from the other last, in that one's frame.
    towards: Vec<Vector>,
    /// Memory that is used again: the pairs of the present piece that are due now and later, and a place.
    due: Vec<Due>,
    later: Vec<Due>,
    place: Place,
}

impl<'a> Sweep<'a> {
    /// A check with this on the table and in the gripper.
    pub fn new(bodies: &'a Bodies, room: &'a Room) -> Sweep<'a> {
        let mut pairs = bodies.pairs.clone();
        pairs.extend(room_pairs(bodies, room));
        let mut sweep = Sweep {
            bodies,
            room,
            left: vec![0.0; pairs.len()],
            watched: [const { Vec::new() }; 3],
            groups: Vec::new(),
            group_of: Vec::with_capacity(pairs.len()),
            towards: vec![Vector::ZERO; pairs.len()],
            due: Vec::new(),
            later: Vec::new(),
            place: Place::default(),
            pairs,
        };
        for pair in &sweep.pairs {
            // One body's pairs follow each other.
            if sweep.groups.last().is_none_or(|group| group.levers != pair.levers) {
                sweep.groups.push(Group { levers: pair.levers, travel: 0.0, bend: 0.0, aside: 0.0 });
            }
            sweep.group_of.push(sweep.groups.len() - 1);
        }
        let watched = |zone| sweep.pairs.iter().map(|pair| sweep.watches(pair, zone)).collect();
        sweep.watched = [watched(Zone::Over), watched(Zone::Between), watched(Zone::Corner)];
        sweep
    }

    /// Checks one place.
    ///
    /// # Errors
    /// The first pair that is too near.
    pub fn place(&mut self, q: &Joints, zone: Zone) -> Result<(), Meeting> {
        self.left.fill(0.0);
        self.piece(q, q, zone, &STRAIGHT)
    }

    /// Checks a straight way in joint space, over everything on the table, that has nothing to do with the
    /// one before.
    ///
    /// # Errors
    /// The first pair that comes too near.
    pub fn way(&mut self, from: &Joints, to: &Joints) -> Result<(), Meeting> {
        self.left.fill(0.0);
        self.piece(from, to, Zone::Over, &STRAIGHT)
    }

    /// The same from a place that [`Sweep::accept_start`] accepts; other ways are not affected.
    ///
    /// # Errors
    /// The first pair that comes too near.
    pub fn way_out(&mut self, from: &Joints, to: &Joints) -> Result<(), Meeting> {
        self.accept_start(from);
        let passed = self.way(from, to);
        self.pairs.iter_mut().for_each(|pair| pair.margin = pair.wanted);
        passed
    }

    /// The pairs that are too near at one place, over everything on the table, each by its number and with
    /// its distance, m; not positive where the two overlap.
    pub fn too_near(&self, q: &Joints) -> Vec<(usize, f64)> {
        let place = self.place_at(q);
        let counted = (0..self.pairs.len()).filter(|index| self.watched[Zone::Over as usize][*index]);
        let distances = counted.map(|index| (index, self.distance(&place, index, false)));
        let wanted = |index: usize| self.pairs[index].wanted;
        distances.filter(|(index, distance)| distance.is_nan() || *distance < wanted(*index)).collect()
    }

    /// The distance that a pair has to keep, by its number, m.
    #[cfg(test)]
    pub(super) fn wanted(&self, pair: usize) -> f64 {
        self.pairs[pair].wanted
    }

    /// True where these pairs that are too near say on which way they part: not where it is unknown how deep
    /// two bodies overlap, nor in the air over the table in which things may lie, whose places are not
    /// known.
    pub fn way_out_is_known(&self, near: &[(usize, f64)]) -> bool {
        near.iter().all(|(index, distance)| {
            let pair = &self.pairs[*index];
            let (a, b) = (self.moving(pair.a), self.other(pair.b));
            let inside_layer = matches!(b.part, Part::Layer | Part::Rim) && *distance <= 0.0;
            !inside_layer && depth_is_known(&a.shape, &b.shape, *distance)
        })
    }

    /// True where something of the arm is in the air over the table in which things may lie.
    pub fn is_low(&self, q: &Joints) -> bool {
        let place = self.place_at(q);
        let layer = |pair: &Pair| matches!(self.other(pair.b).part, Part::Layer | Part::Rim);
        (0..self.pairs.len()).any(|index| {
            layer(&self.pairs[index]) && self.distance(&place, index, false) < self.pairs[index].margin
        })
    }

    /// Distances at the start are accepted as they are where the arm rests nearer to something than it may,
    /// without touching it: such a pair has to keep what it has until it first has what it should.
    pub fn accept_start(&mut self, q: &Joints) {
        let place = self.place_at(q);
        for index in 0..self.pairs.len() {
            let distance = self.distance(&place, index, false);
            let pair = &mut self.pairs[index];
            if distance < pair.margin && distance >= LEAST_M {
                pair.margin = (distance - 2.0 * GRAIN_M).max(LEAST_M);
            }
        }
    }

    /// Checks all joint positions between `from` and `to`, on the straight way or so far from it at most as
    /// `bulge` says.
    ///
    /// # Errors
    /// The first pair that comes too near.
    pub fn piece(&mut self, from: &Joints, to: &Joints, zone: Zone, bulge: &Bulge) -> Result<(), Meeting> {
        let way: [f64; 6] = std::array::from_fn(|j| to.0[j] - from.0[j]);
        self.groups.iter_mut().for_each(|group| group.set_out(&way, bulge));
        let (mut due, mut later) = (std::mem::take(&mut self.due), std::mem::take(&mut self.later));
        let mut place = std::mem::take(&mut self.place);
        self.find_due(zone, &mut due);
        while let Some(share) = due.iter().map(|pair| pair.share).min_by(f64::total_cmp) {
            let q = from.lerp(to, share);
            self.go_to(&q, &way, &mut place);
            // Those that are due soon are measured at the same place, once.
            for pair in due.drain(..) {
                if pair.share > share + TOGETHER {
                    later.push(pair);
                    continue;
                }
                let index = pair.index;
                let share = self.measure(index, &place, share);
                let share = share.map_err(|()| self.meeting(index, &place, q))?;
                later.extend(share.map(|share| Due { share, index }));
            }
            std::mem::swap(&mut due, &mut later);
        }
        (self.due, self.later, self.place) = (due, later, place);
        for (left, group) in self.left.iter_mut().zip(&self.group_of) {
            // `left` counts from the start of the piece; what is used up is measured at the next one's.
            *left = (*left - self.groups[*group].travel).max(0.0);
        }
        Ok(())
    }

    /// Measures one pair at a share of the piece: the share at which it is due again, if on this piece.
    /// An error where it is too near.
    fn measure(&mut self, index: usize, place: &Place, share: f64) -> Result<Option<f64>, ()> {
        let group = &self.groups[self.group_of[index]];
        let (travel, aside) = (group.travel, group.aside * share * (1.0 - share));
        // Where both bodies move, only their levers are known to bound the motion.
        let any_way = Nearing { rate: travel, bend: 0.0 };
        let (distance, nearing) = self.distance_on_way(index, place, 1.0 - share);
        let pair = &mut self.pairs[index];
        let distance = distance - aside;
        if distance >= pair.wanted + GRAIN_M {
            pair.margin = pair.wanted;
        }
        let over = distance - pair.margin;
        // A distance that is no number is no distance.
        if !travel.is_finite() || over.is_nan() || over < 0.0 {
            return Err(());
        }
        let over = over.max(GRAIN_M);
        let nearing = nearing.unwrap_or(any_way);
        let nearer = any_way.after(1.0 - share).min(nearing.after(1.0 - share));
        // So much is left at the end of the piece.
        self.left[index] = over - nearer + travel;
        Ok((nearer > over).then(|| share + any_way.lasts(over).max(nearing.lasts(over))))
    }

    /// A distance that a pair has, m, exact where it is near; and, of one whose other body stands, how fast
    /// it is used up. `rest` is the share of the piece that is left.
    fn distance_on_way(&mut self, index: usize, place: &Place, rest: f64) -> (f64, Option<Nearing>) {
        let pair = &self.pairs[index];
        let group = &self.groups[self.group_of[index]];
        let (a, b) = (self.moving(pair.a), self.other(pair.b));
        let (twist, middle) = (&place.twists[a.frame], place.middles[pair.a]);
        let stands = !matches!(pair.b, Other::Moving(_));
        let nearing = |direction: Vector, reach: f64| {
            let rate = twist.speed_along(direction, middle, reach) + group.aside;
            Nearing { rate, bend: group.bend }
        };
        let other_middle = self.middle(place, pair.b);
        let sure = surely_apart(&a.shape, middle, &b.shape, other_middle);
        // A ball round a body does not turn with it.
        let ball = (other_middle - middle).try_normalize().filter(|_| stands).map(|to| nearing(to, 0.0));
        let over = sure - pair.margin - 0.25 * group.aside;
        let lasts = ball.is_some_and(|ball| over > ball.after(rest).max(0.0));
        if sure - pair.margin > FAR_M || lasts {
            return (sure, ball);
        }
        let mut towards = self.towards[index];
        let (from, to) = (&place.frames[a.frame], &place.frames[b.frame]);
        let distance = apart_from(&a.shape, from, &b.shape, to, &mut towards);
        let direction = towards.try_normalize().filter(|_| stands);
        let nearing = direction.map(|towards| nearing(from.rotation * towards, a.shape.reach()));
        self.towards[index] = towards;
        (distance, nearing)
    }

    /// The pairs that have to be measured on the present piece, and where first.
    fn find_due(&mut self, zone: Zone, due: &mut Vec<Due>) {
        due.clear();
        let pairs = self.left.iter_mut().zip(&self.watched[zone as usize]).zip(&self.group_of);
        for (index, ((left, watched), group)) in pairs.enumerate() {
            if !watched {
                // What is not watched has no distance left to rely on.
                *left = 0.0;
                continue;
            }
            let travel = self.groups[*group].travel;
            // Of what is no number nothing is left.
            if *left > 0.0 && *left >= travel {
                continue;
            }
            let share = if *left > 0.0 && travel.is_finite() { *left / travel } else { 0.0 };
            due.push(Due { share, index });
        }
    }

    fn watches(&self, pair: &Pair, zone: Zone) -> bool {
        let (a, b) = (self.moving(pair.a).part, self.other(pair.b).part);
        match (zone, b) {
            // Between the objects forearm and elbow are over everything still, seen or not.
            (Zone::Between, Part::Layer) => matches!(a, Part::Link(2 | 3)),
            (Zone::Over, Part::Standing) | (Zone::Between, Part::Rim) => false,
            (Zone::Corner, Part::Layer | Part::Rim) => false,
            (Zone::Over | Zone::Between, Part::CornerLayer | Part::CornerRim) => false,
            (Zone::Between, Part::Standing | Part::Tall | Part::Table) => {
                !matches!(a, Part::Cups | Part::Load)
            }
            _ => true,
        }
    }

    fn moving(&self, index: usize) -> &Body {
        let own = &self.bodies.moving;
        own.get(index).or(self.room.load.as_ref()).unwrap_or(&own[0])
    }

    fn other(&self, other: Other) -> &Body {
        match other {
            Other::Moving(index) => self.moving(index),
            Other::Fixed(index) => &self.bodies.fixed[index],
            Other::Room(index) => &self.room.bodies[index],
        }
    }

    fn place_at(&self, q: &Joints) -> Place {
        let mut place = Place::default();
        self.go_to(q, &[0.0; 6], &mut place);
        place
    }

    fn go_to(&self, q: &Joints, way: &[f64; 6], place: &mut Place) {
        let (frames, twists) = chains::moving(&self.bodies.chain, q, way);
        let moving = self.bodies.moving.iter().chain(&self.room.load);
        place.middles.clear();
        place.middles.extend(moving.map(|body| frames[body.frame] * body.shape.middle()));
        (place.frames, place.twists) = (frames, twists);
    }

    /// The middle of a pair's second body, base frame: what does not move is in it.
    fn middle(&self, place: &Place, other: Other) -> Vector {
        match other {
            Other::Moving(index) => place.middles[index],
            Other::Fixed(_) | Other::Room(_) => self.other(other).shape.middle(),
        }
    }

    /// Distance of a pair: exact where it is near or `exact` is set, else one that it surely has.
    fn distance(&self, place: &Place, index: usize, exact: bool) -> f64 {
        let pair = &self.pairs[index];
        let (a, b) = (self.moving(pair.a), self.other(pair.b));
        let sure = surely_apart(&a.shape, place.middles[pair.a], &b.shape, self.middle(place, pair.b));
        if sure - pair.margin > FAR_M && !exact {
            return sure;
        }
        apart(&a.shape, &place.frames[a.frame], &b.shape, &place.frames[b.frame])
    }

    fn meeting(&self, index: usize, place: &Place, at: Joints) -> Meeting {
        let pair = &self.pairs[index];
        let names = [self.moving(pair.a), self.other(pair.b)].map(|body| body.name.clone());
        let [one, other] = names;
        Meeting { one, other, distance: self.distance(place, index, true), at }
    }
}

/// What is in the room against what moves, and what is held against everything.
fn room_pairs(bodies: &Bodies, room: &Room) -> Vec<Pair> {
    let load = room.load.as_ref().map(|load| (bodies.moving.len(), load));
    let mut pairs = Vec::new();
    for (a, body) in bodies.moving.iter().enumerate().chain(load) {
        let levers = bodies.levers(body, 0);
        for (b, other) in room.bodies.iter().enumerate() {
            if let Some(margin) = room_margin(body.part, other.part, bodies.margin) {
                pairs.push(Pair::new(a, Other::Room(b), margin, against(levers, &other.shape)));
            }
        }
    }
    let Some((index, load)) = load else { return pairs };
    for (a, body) in bodies.moving.iter().enumerate() {
        if let Some(margin) = super::own_margin(body, load) {
            let levers = bodies.levers(load, body.frame);
            pairs.push(Pair::new(a, Other::Moving(index), margin, levers));
        }
    }
    for (b, other) in bodies.fixed.iter().enumerate() {
        if let Some(margin) = bodies.margin_to(load, other) {
            let levers = against(bodies.levers(load, 0), &other.shape);
            pairs.push(Pair::new(index, Other::Fixed(b), margin, levers));
        }
    }
    pairs
}

/// Distance that a body keeps to something on the table. Over the table the heights leave air already.
fn room_margin(part: Part, other: Part, margin: f64) -> Option<f64> {
    match (part, other) {
        (Part::Link(0 | 1), Part::Layer | Part::CornerLayer | Part::Standing | Part::Tall) => None,
        (Part::Joint, _) => None,
        // Links pass over the rim where there is nothing but the robot's own base.
        (Part::Link(_), Part::Rim | Part::CornerRim) => None,
        (_, Part::Layer | Part::Rim | Part::CornerLayer | Part::CornerRim) => Some(0.0),
        // Counted in corners alone, which are over all that is no higher than was expected.
        (Part::Cups | Part::Load, Part::Standing) => Some(0.0),
        _ => Some(margin),
    }
}
