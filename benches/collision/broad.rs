//! Broad phases in comparison: bounding discs alone, a uniform grid, a quadtree, and the tree of boxes of
//! `parry2d`, before the same exact test.
//!
//! In: arrangements of 20 to 200 objects of RAND, density 0.4, by seed; poses of one of their objects, the
//! others being where they are. Out: nanoseconds a check of one pose, for poses drawn uniformly and for
//! those among them that are free (a drawn pose mostly ends at the first object it meets, a free one passes
//! all), and nanoseconds to keep the structure when an object moves. The paper tried the first three and
//! kept the discs. All have to answer alike.

use crate::parry::Tree;
use crate::{PAIRS, SEED, nanoseconds};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rearrange::geometry::collision::Placed;
use rearrange::geometry::footprint::Footprint;
use rearrange::geometry::pose::Pose2;
use rearrange::planning::generate::{RatioLaw, Recipe, Scenario, generate};
use std::cell::Cell;

const DENSITY: f64 = 0.4;

/// Objects of a leaf of the quadtree before it is divided, and its deepest level.
const LEAF: usize = 4;
const DEEPEST: u32 = 6;

/// A disc around an object.
#[derive(Clone, Copy)]
pub struct Ball {
    pub x: f64,
    pub y: f64,
    pub radius: f64,
}

impl Ball {
    fn of(footprint: &Footprint, pose: &Pose2) -> Ball {
        Ball { x: pose.x, y: pose.y, radius: footprint.bounding_radius() }
    }
}

/// Keeps where objects are and names those that may meet a disc, some of them perhaps twice.
pub trait Broad {
    fn insert(&mut self, object: usize, ball: Ball);
    fn remove(&mut self, object: usize, ball: Ball);
    /// True as soon as `test` is true of a candidate.
    fn any(&self, ball: Ball, test: &mut dyn FnMut(usize) -> bool) -> bool;
}

/// No structure: every object is a candidate, and the exact test begins with the discs.
struct Discs(Vec<usize>);

impl Broad for Discs {
    fn insert(&mut self, object: usize, _: Ball) {
        self.0.push(object);
    }

    fn remove(&mut self, object: usize, _: Ball) {
        self.0.retain(|o| *o != object);
    }

    fn any(&self, _: Ball, test: &mut dyn FnMut(usize) -> bool) -> bool {
        self.0.iter().any(|object| test(*object))
    }
}

/// Cells of a size with the mean object, each with the objects whose bounding square touches it.
struct Grid {
    side: usize,
    cells: Vec<Vec<usize>>,
}

impl Grid {
    fn new(objects: usize) -> Grid {
        let side = (objects as f64).sqrt().ceil() as usize;
        Grid { side, cells: vec![Vec::new(); side * side] }
    }

    fn indices(&self, ball: Ball) -> impl Iterator<Item = usize> + use<> {
        let side = self.side;
        let cell = move |at: f64| ((at * side as f64).max(0.0) as usize).min(side - 1);
        let columns = cell(ball.x - ball.radius)..=cell(ball.x + ball.radius);
        let rows = cell(ball.y - ball.radius)..=cell(ball.y + ball.radius);
        rows.flat_map(move |row| columns.clone().map(move |column| row * side + column))
    }
}

impl Broad for Grid {
    fn insert(&mut self, object: usize, ball: Ball) {
        self.indices(ball).for_each(|cell| self.cells[cell].push(object));
    }

    fn remove(&mut self, object: usize, ball: Ball) {
        self.indices(ball).for_each(|cell| self.cells[cell].retain(|o| *o != object));
    }

    fn any(&self, ball: Ball, test: &mut dyn FnMut(usize) -> bool) -> bool {
        // Each object once: an exact test costs more than the mark.
        let mut seen = [0_u64; 4];
        self.indices(ball).flat_map(|cell| &self.cells[cell]).any(|&object| {
            let (word, bit) = (object / 64, 1 << (object % 64));
            let fresh = seen[word] & bit == 0;
            seen[word] |= bit;
            fresh && test(object)
        })
    }
}

/// An object lies in the smallest square that holds its bounding square whole.
struct Quadtree {
    objects: Vec<(usize, Ball)>,
    children: Vec<Quadtree>,
    corner: [f64; 2],
    side: f64,
    level: u32,
}

impl Quadtree {
    fn new(corner: [f64; 2], side: f64, level: u32) -> Quadtree {
        Quadtree { objects: Vec::new(), children: Vec::new(), corner, side, level }
    }

    fn child(&self, ball: Ball) -> Option<usize> {
        let half = |at: f64, low: f64| {
            let middle = low + self.side / 2.0;
            if at + ball.radius <= middle { Some(0) } else { (at - ball.radius >= middle).then_some(1) }
        };
        Some(half(ball.x, self.corner[0])? + 2 * half(ball.y, self.corner[1])?)
    }

    fn divide(&mut self) {
        let side = self.side / 2.0;
        for part in [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]] {
            let corner = [self.corner[0] + part[0] * side, self.corner[1] + part[1] * side];
            self.children.push(Quadtree::new(corner, side, self.level + 1));
        }
        for (object, ball) in std::mem::take(&mut self.objects) {
            self.insert(object, ball);
        }
    }

    fn meets(&self, ball: Ball) -> bool {
        let apart = |at: f64, low: f64| at + ball.radius < low || at - ball.radius > low + self.side;
        !apart(ball.x, self.corner[0]) && !apart(ball.y, self.corner[1])
    }
}

impl Broad for Quadtree {
    fn insert(&mut self, object: usize, ball: Ball) {
        match self.child(ball) {
            Some(child) if !self.children.is_empty() => self.children[child].insert(object, ball),
            _ => {
                self.objects.push((object, ball));
                if self.children.is_empty() && self.objects.len() > LEAF && self.level < DEEPEST {
                    self.divide();
                }
            }
        }
    }

    fn remove(&mut self, object: usize, ball: Ball) {
        match self.child(ball) {
            Some(child) if !self.children.is_empty() => self.children[child].remove(object, ball),
            _ => self.objects.retain(|(o, _)| *o != object),
        }
    }

    fn any(&self, ball: Ball, test: &mut dyn FnMut(usize) -> bool) -> bool {
        // An object over the table's edge (none here) would lie at the root, which is always looked through.
        self.objects.iter().any(|(object, _)| test(*object))
            || self.children.iter().any(|child| child.meets(ball) && child.any(ball, test))
    }
}

/// Objects where they are, and poses to check.
struct Scene {
    footprints: Vec<Footprint>,
    starts: Vec<Pose2>,
    placed: Vec<Placed>,
}

struct Question {
    object: usize,
    ball: Ball,
    placed: Placed,
}

impl Scene {
    fn new(objects: usize) -> Scene {
        let recipe = Recipe { scenario: Scenario::Rand, objects, density: DENSITY, ratios: RatioLaw::Paper };
        let generated = generate(&recipe, SEED, 0).expect("an arrangement");
        let footprints: Vec<Footprint> =
            generated.instance.objects.iter().map(|object| object.footprint.clone()).collect();
        let starts: Vec<Pose2> =
            generated.instance.objects.iter().filter_map(|object| object.start).collect();
        let placed = footprints.iter().zip(&starts).map(|(shape, pose)| Placed::new(shape, *pose)).collect();
        Scene { footprints, starts, placed }
    }

    fn ball(&self, object: usize) -> Ball {
        Ball::of(&self.footprints[object], &self.starts[object])
    }

    fn fill(&self, broad: &mut dyn Broad) {
        (0..self.starts.len()).for_each(|object| broad.insert(object, self.ball(object)));
    }

    fn collides(&self, broad: &dyn Broad, question: &Question) -> bool {
        broad.any(question.ball, &mut |other| {
            other != question.object && question.placed.collides(&self.placed[other])
        })
    }

    /// Poses on the table, of all objects in turn; of the free ones only, if requested.
    fn questions(&self, free: bool) -> Vec<Question> {
        let mut all = Discs(Vec::new());
        self.fill(&mut all);
        let mut rng = ChaCha8Rng::seed_from_u64(SEED);
        let mut out = Vec::with_capacity(PAIRS);
        while out.len() < PAIRS {
            let object = rng.random_range(0..self.starts.len());
            let footprint = &self.footprints[object];
            let inner = footprint.bounding_radius();
            let mut number = |least: f64, most: f64| rng.random_range(least..most);
            let pose = Pose2::new(
                number(inner, 1.0 - inner),
                number(inner, 1.0 - inner),
                number(0.0, std::f64::consts::TAU),
            );
            let placed = Placed::new(footprint, pose);
            let question = Question { object, ball: Ball::of(footprint, &pose), placed };
            if !free || !self.collides(&all, &question) {
                out.push(question);
            }
        }
        out
    }
}

/// Prints the table.
pub fn run() {
    println!(
        "\n{:<22} {:>10} {:>10} {:>10} {:>10}",
        "ns a check of a pose", "any", "free", "move", "colliding"
    );
    for objects in [20, 40, 60, 100, 200] {
        let scene = Scene::new(objects);
        let (any, free) = (scene.questions(false), scene.questions(true));
        let made: [(&str, Box<dyn Broad>); 4] = [
            ("discs", Box::new(Discs(Vec::new()))),
            ("grid", Box::new(Grid::new(objects))),
            ("quadtree", Box::new(Quadtree::new([0.0, 0.0], 1.0, 0))),
            ("parry2d's tree", Box::new(Tree::new())),
        ];
        let mut answers = Vec::new();
        for (name, mut broad) in made {
            scene.fill(broad.as_mut());
            let colliding = any.iter().filter(|question| scene.collides(broad.as_ref(), question)).count();
            println!(
                "{:<22} {:>10.1} {:>10.1} {:>10.1} {:>9.0}%",
                format!("{objects} objects, {name}"),
                nanoseconds(|k| scene.collides(broad.as_ref(), &any[k])),
                nanoseconds(|k| scene.collides(broad.as_ref(), &free[k])),
                moved(&scene, broad),
                100.0 * colliding as f64 / PAIRS as f64
            );
            answers.push(colliding);
        }
        assert!(answers.iter().all(|count| *count == answers[0]), "the broad phases differ: {answers:?}");
    }
}

/// Nanoseconds to take an object out and put it back in.
fn moved(scene: &Scene, broad: Box<dyn Broad>) -> f64 {
    let broad = Cell::new(Some(broad));
    nanoseconds(|k| {
        let object = k % scene.starts.len();
        let mut inside = broad.take();
        if let Some(broad) = inside.as_mut() {
            broad.remove(object, scene.ball(object));
            broad.insert(object, scene.ball(object));
        }
        broad.set(inside);
    })
}
