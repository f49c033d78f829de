//! A set of objects as a fixed bitset: the unit all graph algorithms of `planning` calculate with.
//!
//! In and out: object (or vertex) indices below [`ObjectSet::CAPACITY`]. Copied by value: four machine words
//! are cheaper than an allocation, and the largest public instances have 200 objects. Where speed counts and
//! the indices are known to be below 64, [`Bits`] of one word do.

use std::ops::{BitAnd, BitOr, Not, Sub};

/// A set of indices in `0..64 * WORDS`.
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Bits<const WORDS: usize>([u64; WORDS]);

/// A set of objects. Its capacity is the largest number of objects a problem may have for solvers and bound.
pub type ObjectSet = Bits<4>;

impl<const WORDS: usize> Default for Bits<WORDS> {
    fn default() -> Bits<WORDS> {
        Bits::EMPTY
    }
}

impl<const WORDS: usize> Bits<WORDS> {
    /// How many indices there are.
    pub const CAPACITY: usize = 64 * WORDS;

    /// No object.
    pub const EMPTY: Bits<WORDS> = Bits([0; WORDS]);

    /// The same members in another width; those beyond its capacity are lost.
    pub fn resized<const OTHER: usize>(self) -> Bits<OTHER> {
        Bits(std::array::from_fn(|k| if k < WORDS { self.0[k] } else { 0 }))
    }

    /// The objects `0..count`.
    pub fn first(count: usize) -> Bits<WORDS> {
        (0..count).collect()
    }

    /// Adds `index`, which must be below the capacity.
    pub fn insert(&mut self, index: usize) {
        self.0[index / 64] |= 1 << (index % 64);
    }

    /// Takes `index` out.
    pub fn remove(&mut self, index: usize) {
        self.0[index / 64] &= !(1 << (index % 64));
    }

    /// Is `index` in the set?
    pub fn contains(&self, index: usize) -> bool {
        self.0[index / 64] >> (index % 64) & 1 == 1
    }

    /// This set and `index`.
    pub fn with(mut self, index: usize) -> Bits<WORDS> {
        self.insert(index);
        self
    }

    /// This set without `index`.
    pub fn without(mut self, index: usize) -> Bits<WORDS> {
        self.remove(index);
        self
    }

    /// Number of members.
    pub fn len(&self) -> usize {
        self.0.iter().map(|word| word.count_ones() as usize).sum()
    }

    /// Has no member.
    pub fn is_empty(&self) -> bool {
        self.0 == [0; WORDS]
    }

    /// Every member is also in `other`.
    pub fn is_subset(&self, other: &Bits<WORDS>) -> bool {
        self.0.iter().zip(&other.0).all(|(a, b)| a & !b == 0)
    }

    /// No member in common with `other`.
    pub fn is_disjoint(&self, other: &Bits<WORDS>) -> bool {
        self.0.iter().zip(&other.0).all(|(a, b)| a & b == 0)
    }

    /// The smallest member.
    pub fn smallest(&self) -> Option<usize> {
        self.0
            .iter()
            .enumerate()
            .find(|(_, word)| **word != 0)
            .map(|(at, w)| at * 64 + w.trailing_zeros() as usize)
    }

    /// The members in increasing order.
    pub fn iter(&self) -> Members<WORDS> {
        Members { words: self.0, at: 0 }
    }

    /// Sum of the members' weights.
    pub fn weight<W: Copy + std::iter::Sum<W>>(&self, weights: &[W]) -> W {
        self.iter().map(|index| weights[index]).sum()
    }
}

/// Iterator over the members of a set.
pub struct Members<const WORDS: usize> {
    words: [u64; WORDS],
    at: usize,
}

impl<const WORDS: usize> Iterator for Members<WORDS> {
    type Item = usize;

    fn next(&mut self) -> Option<usize> {
        while self.at < WORDS {
            let word = self.words[self.at];
            if word != 0 {
                self.words[self.at] = word & (word - 1);
                return Some(self.at * 64 + word.trailing_zeros() as usize);
            }
            self.at += 1;
        }
        None
    }
}

impl<const WORDS: usize> FromIterator<usize> for Bits<WORDS> {
    fn from_iter<I: IntoIterator<Item = usize>>(indices: I) -> Bits<WORDS> {
        indices.into_iter().fold(Bits::EMPTY, Bits::with)
    }
}

impl<const WORDS: usize> IntoIterator for Bits<WORDS> {
    type Item = usize;
    type IntoIter = Members<WORDS>;

    fn into_iter(self) -> Members<WORDS> {
        self.iter()
    }
}

impl<const WORDS: usize> BitAnd for Bits<WORDS> {
    type Output = Bits<WORDS>;

    fn bitand(self, other: Bits<WORDS>) -> Bits<WORDS> {
        Bits(std::array::from_fn(|k| self.0[k] & other.0[k]))
    }
}

impl<const WORDS: usize> BitOr for Bits<WORDS> {
    type Output = Bits<WORDS>;

    fn bitor(self, other: Bits<WORDS>) -> Bits<WORDS> {
        Bits(std::array::from_fn(|k| self.0[k] | other.0[k]))
    }
}

impl<const WORDS: usize> Sub for Bits<WORDS> {
    type Output = Bits<WORDS>;

    fn sub(self, other: Bits<WORDS>) -> Bits<WORDS> {
        Bits(std::array::from_fn(|k| self.0[k] & !other.0[k]))
    }
}

impl<const WORDS: usize> Not for Bits<WORDS> {
    type Output = Bits<WORDS>;

    fn not(self) -> Bits<WORDS> {
        Bits(self.0.map(|word| !word))
    }
}

impl<const WORDS: usize> std::fmt::Debug for Bits<WORDS> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_set().entries(self.iter()).finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn members_come_back_in_order_across_words() {
        let set: ObjectSet = [200, 3, 64, 63].into_iter().collect();
        assert_eq!(set.iter().collect::<Vec<_>>(), [3, 63, 64, 200]);
        assert_eq!(set.len(), 4);
        assert_eq!(set.without(3).smallest(), Some(63));
        assert!(ObjectSet::EMPTY.smallest().is_none());
    }

    #[test]
    fn set_algebra() {
        let a: ObjectSet = [1, 2, 100].into_iter().collect();
        let b: ObjectSet = [2, 255].into_iter().collect();
        assert_eq!(a & b, ObjectSet::EMPTY.with(2));
        assert_eq!((a - b).len(), 2);
        assert!((a & b).is_subset(&b) && !a.is_subset(&b));
        assert!((a - b).is_disjoint(&b));
        assert_eq!(a.weight(&(0..256).collect::<Vec<usize>>()), 103);
    }
}
