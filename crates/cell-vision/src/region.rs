//! Parts of the table: what a look has to show, and what was disturbed.
//!
//! In: discs. Out: whether a place is in one of them. Table frame, m. Pure.

use serde::{Deserialize, Serialize};

/// A part of the table as the union of discs.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize)]
pub struct Region {
    discs: Vec<Disc>,
}

#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
struct Disc {
    centre: [f64; 2],
    radius_m: f64,
}

impl Region {
    /// One disc.
    pub fn disc(centre: [f64; 2], radius_m: f64) -> Region {
        Region { discs: vec![Disc { centre, radius_m }] }
    }

    /// Adds all of another region.
    pub fn join(&mut self, other: &Region) {
        for disc in &other.discs {
            if !self.discs.contains(disc) {
                self.discs.push(*disc);
            }
        }
    }

    /// Middle and radius of each of its discs.
    pub fn discs(&self) -> impl Iterator<Item = ([f64; 2], f64)> {
        self.discs.iter().map(|disc| (disc.centre, disc.radius_m))
    }

    /// No place is in it.
    pub fn is_empty(&self) -> bool {
        self.discs.is_empty()
    }

    /// Whether a place is in it.
    pub fn contains(&self, [x, y]: [f64; 2]) -> bool {
        self.discs.iter().any(|disc| (x - disc.centre[0]).hypot(y - disc.centre[1]) <= disc.radius_m)
    }

    /// Whether all of a disc is in one of its discs.
    pub fn contains_disc(&self, [x, y]: [f64; 2], radius_m: f64) -> bool {
        let within = |disc: &Disc| (x - disc.centre[0]).hypot(y - disc.centre[1]) + radius_m <= disc.radius_m;
        self.discs.iter().any(within)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_region_is_the_union_of_its_discs() {
        let mut region = Region::disc([0.1, 0.1], 0.05);
        region.join(&Region::disc([0.3, 0.1], 0.02));
        region.join(&Region::disc([0.3, 0.1], 0.02));
        assert_eq!(region.discs.len(), 2, "what is in it already is not added");
        assert!(region.contains([0.14, 0.1]) && region.contains([0.3, 0.12]) && !region.contains([0.2, 0.1]));
        assert!(region.contains_disc([0.12, 0.1], 0.03) && !region.contains_disc([0.12, 0.1], 0.031));
        assert!(Region::default().is_empty() && !Region::default().contains([0.0, 0.0]));
    }
}
