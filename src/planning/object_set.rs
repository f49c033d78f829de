//! A set of objects as a fixed bitset: the unit all graph algorithms of `planning` calculate with.
//!
//! In and out: object (or vertex) indices below [`ObjectSet::CAPACITY`]. Copied by value: four machine words
//! are cheaper than an allocation, and the largest public instances have 200 objects.

use std::ops::{BitAnd, BitOr, Not, Sub};

const WORDS: usize = 4;

/// A set of indices in `0..CAPACITY`.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Default, PartialOrd, Ord)]
pub struct ObjectSet([u64; WORDS]);

impl ObjectSet {
    /// The largest number of objects a problem may have for the solvers and the bound.
    pub const CAPACITY: usize = 64 * WORDS;

    /// No object.
    pub const EMPTY: ObjectSet = ObjectSet([0; WORDS]);

    /// The objects `0..count`.
    pub fn first(count: usize) -> ObjectSet {
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
    pub fn with(mut self, index: usize) -> ObjectSet {
        self.insert(index);
        self
    }

    /// This set without `index`.
    pub fn without(mut self, index: usize) -> ObjectSet {
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
    pub fn is_subset(&self, other: &ObjectSet) -> bool {
        self.0.iter().zip(&other.0).all(|(a, b)| a & !b == 0)
    }

    /// No member in common with `other`.
    pub fn is_disjoint(&self, other: &ObjectSet) -> bool {
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
    pub fn iter(&self) -> Members {
        Members { words: self.0, at: 0 }
    }

    /// Sum of the members' weights.
    pub fn weight<W: Copy + std::iter::Sum<W>>(&self, weights: &[W]) -> W {
        self.iter().map(|index| weights[index]).sum()
    }
}

/// Iterator over the members of an [`ObjectSet`].
pub struct Members {
    words: [u64; WORDS],
    at: usize,
}

impl Iterator for Members {
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

impl FromIterator<usize> for ObjectSet {
    fn from_iter<I: IntoIterator<Item = usize>>(indices: I) -> ObjectSet {
        indices.into_iter().fold(ObjectSet::EMPTY, ObjectSet::with)
    }
}

impl IntoIterator for ObjectSet {
    type Item = usize;
    type IntoIter = Members;

    fn into_iter(self) -> Members {
        self.iter()
    }
}

impl BitAnd for ObjectSet {
    type Output = ObjectSet;

    fn bitand(self, other: ObjectSet) -> ObjectSet {
        ObjectSet(std::array::from_fn(|k| self.0[k] & other.0[k]))
    }
}

impl BitOr for ObjectSet {
    type Output = ObjectSet;

    fn bitor(self, other: ObjectSet) -> ObjectSet {
        ObjectSet(std::array::from_fn(|k| self.0[k] | other.0[k]))
    }
}

impl Sub for ObjectSet {
    type Output = ObjectSet;

    fn sub(self, other: ObjectSet) -> ObjectSet {
        ObjectSet(std::array::from_fn(|k| self.0[k] & !other.0[k]))
    }
}

impl Not for ObjectSet {
    type Output = ObjectSet;

    fn not(self) -> ObjectSet {
        ObjectSet(self.0.map(|word| !word))
    }
}

impl std::fmt::Debug for ObjectSet {
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
