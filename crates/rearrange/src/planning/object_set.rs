//! Sets of objects: the unit all graph algorithms of `planning` calculate with.
//!
//! In and out: indices of objects or vertices. [`ObjectSet`] takes any number of them: 256 lie in the set
//! itself, more on the heap, so that the tables people have cost no allocation. [`Bits`] has a fixed width
//! and is copied by value: the search for feedback vertex sets spends its time on such sets.

use std::ops::{BitAnd, BitOr, Not, Sub};

/// Words of an [`ObjectSet`] that need no allocation.
const INLINE_WORDS: usize = 4;

/// A set of objects, of any number.
///
/// `more` never ends with a word of zeros, so that equal sets have equal words.
#[derive(Clone, PartialEq, Eq, Hash, PartialOrd, Ord, Default)]
pub struct ObjectSet {
    few: [u64; INLINE_WORDS],
    more: Vec<u64>,
}

impl ObjectSet {
    /// No object.
    pub const EMPTY: ObjectSet = ObjectSet { few: [0; INLINE_WORDS], more: Vec::new() };

    /// The objects `0..count`.
    pub fn first(count: usize) -> ObjectSet {
        (0..count).collect()
    }

    /// Adds `index`.
    pub fn insert(&mut self, index: usize) {
        let (word, bit) = (index / 64, 1 << (index % 64));
        match word.checked_sub(INLINE_WORDS) {
            None => self.few[word] |= bit,
            Some(word) => {
                if word >= self.more.len() {
                    self.more.resize(word + 1, 0);
                }
                self.more[word] |= bit;
            }
        }
    }

    /// Takes `index` out.
    pub fn remove(&mut self, index: usize) {
        let (word, bit) = (index / 64, 1 << (index % 64));
        match word.checked_sub(INLINE_WORDS) {
            None => self.few[word] &= !bit,
            Some(word) if word < self.more.len() => {
                self.more[word] &= !bit;
                self.trim();
            }
            Some(_) => {}
        }
    }

    /// Is `index` in the set?
    pub fn contains(&self, index: usize) -> bool {
        self.word(index / 64) >> (index % 64) & 1 == 1
    }

    /// This set and `index`.
    pub fn with(&self, index: usize) -> ObjectSet {
        let mut set = self.clone();
        set.insert(index);
        set
    }

    /// This set without `index`.
    pub fn without(&self, index: usize) -> ObjectSet {
        let mut set = self.clone();
        set.remove(index);
        set
    }

    /// Adds the members of `other`.
    pub fn extend(&mut self, other: &ObjectSet) {
        self.few.iter_mut().zip(&other.few).for_each(|(a, b)| *a |= b);
        if self.more.len() < other.more.len() {
            self.more.resize(other.more.len(), 0);
        }
        self.more.iter_mut().zip(&other.more).for_each(|(a, b)| *a |= b);
    }

    /// Number of members.
    pub fn len(&self) -> usize {
        self.words().map(|word| word.count_ones() as usize).sum()
    }

    /// Has no member.
    pub fn is_empty(&self) -> bool {
        self.few == [0; INLINE_WORDS] && self.more.is_empty()
    }

    /// Every member is also in `other`.
    pub fn is_subset(&self, other: &ObjectSet) -> bool {
        self.words().enumerate().all(|(at, word)| word & !other.word(at) == 0)
    }

    /// No member in common with `other`.
    pub fn is_disjoint(&self, other: &ObjectSet) -> bool {
        self.words().zip(other.words()).all(|(a, b)| a & b == 0)
    }

    /// The smallest member.
    pub fn smallest(&self) -> Option<usize> {
        self.iter().next()
    }

    /// The members in increasing order.
    pub fn iter(&self) -> Members<'_> {
        Members { set: self, at: 0, word: self.few[0] }
    }

    /// Sum of the members' weights.
    pub fn weight<W: Copy + std::iter::Sum<W>>(&self, weights: &[W]) -> W {
        self.iter().map(|index| weights[index]).sum()
    }

    /// The members below the capacity of a set of fixed width.
    pub fn bits<const WORDS: usize>(&self) -> Bits<WORDS> {
        Bits(std::array::from_fn(|at| self.word(at)))
    }

    fn word(&self, at: usize) -> u64 {
        let (few, more) = (self.few.get(at), self.more.get(at.wrapping_sub(INLINE_WORDS)));
        few.or(more).copied().unwrap_or(0)
    }

    fn words(&self) -> impl Iterator<Item = u64> + '_ {
        self.few.iter().chain(&self.more).copied()
    }

    fn trim(&mut self) {
        while self.more.last() == Some(&0) {
            self.more.pop();
        }
    }

    /// The set of `combine` of each pair of words; a word that a set does not have is 0.
    fn combined(&self, other: &ObjectSet, words: usize, combine: impl Fn(u64, u64) -> u64) -> ObjectSet {
        let few = std::array::from_fn(|at| combine(self.few[at], other.few[at]));
        let pair = |at: usize| combine(self.word(INLINE_WORDS + at), other.word(INLINE_WORDS + at));
        let mut set = ObjectSet { few, more: (0..words).map(pair).collect() };
        set.trim();
        set
    }

    fn intersection(&self, other: &ObjectSet) -> ObjectSet {
        self.combined(other, self.more.len().min(other.more.len()), |a, b| a & b)
    }

    fn union(&self, other: &ObjectSet) -> ObjectSet {
        self.combined(other, self.more.len().max(other.more.len()), |a, b| a | b)
    }

    fn difference(&self, other: &ObjectSet) -> ObjectSet {
        self.combined(other, self.more.len(), |a, b| a & !b)
    }
}

/// Both operands by value or by reference.
macro_rules! set_operator {
    ($operator:ident, $method:ident, $of:ident) => {
        impl std::ops::$operator<&ObjectSet> for &ObjectSet {
            type Output = ObjectSet;

            fn $method(self, other: &ObjectSet) -> ObjectSet {
                self.$of(other)
            }
        }

        impl std::ops::$operator<ObjectSet> for &ObjectSet {
            type Output = ObjectSet;

            fn $method(self, other: ObjectSet) -> ObjectSet {
                self.$of(&other)
            }
        }

        impl std::ops::$operator<&ObjectSet> for ObjectSet {
            type Output = ObjectSet;

            fn $method(self, other: &ObjectSet) -> ObjectSet {
                self.$of(other)
            }
        }

        impl std::ops::$operator<ObjectSet> for ObjectSet {
            type Output = ObjectSet;

            fn $method(self, other: ObjectSet) -> ObjectSet {
                self.$of(&other)
            }
        }
    };
}

set_operator!(BitAnd, bitand, intersection);
set_operator!(BitOr, bitor, union);
set_operator!(Sub, sub, difference);

/// The members of a set, by reference.
pub struct Members<'a> {
    set: &'a ObjectSet,
    at: usize,
    /// What is left of the word at `at`.
    word: u64,
}

impl Iterator for Members<'_> {
    type Item = usize;

    fn next(&mut self) -> Option<usize> {
        while self.word == 0 {
            self.at += 1;
            if self.at >= INLINE_WORDS + self.set.more.len() {
                return None;
            }
            self.word = self.set.word(self.at);
        }
        let bit = self.word.trailing_zeros() as usize;
        self.word &= self.word - 1;
        Some(self.at * 64 + bit)
    }
}

/// The members of a set that is used up.
pub struct IntoMembers {
    set: ObjectSet,
    at: usize,
}

impl Iterator for IntoMembers {
    type Item = usize;

    fn next(&mut self) -> Option<usize> {
        while self.at < INLINE_WORDS + self.set.more.len() {
            let word = match self.at.checked_sub(INLINE_WORDS) {
                None => &mut self.set.few[self.at],
                Some(at) => &mut self.set.more[at],
            };
            if *word != 0 {
                let bit = word.trailing_zeros() as usize;
                *word &= *word - 1;
                return Some(self.at * 64 + bit);
            }
            self.at += 1;
        }
        None
    }
}

impl IntoIterator for ObjectSet {
    type Item = usize;
    type IntoIter = IntoMembers;

    fn into_iter(self) -> IntoMembers {
        IntoMembers { set: self, at: 0 }
    }
}

impl<'a> IntoIterator for &'a ObjectSet {
    type Item = usize;
    type IntoIter = Members<'a>;

    fn into_iter(self) -> Members<'a> {
        self.iter()
    }
}

impl FromIterator<usize> for ObjectSet {
    fn from_iter<I: IntoIterator<Item = usize>>(indices: I) -> ObjectSet {
        let mut set = ObjectSet::EMPTY;
        indices.into_iter().for_each(|index| set.insert(index));
        set
    }
}

impl<const WORDS: usize> From<Bits<WORDS>> for ObjectSet {
    fn from(bits: Bits<WORDS>) -> ObjectSet {
        bits.iter().collect()
    }
}

impl std::fmt::Debug for ObjectSet {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_set().entries(self.iter()).finish()
    }
}

/// A set of indices in `0..64 * WORDS`.
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Bits<const WORDS: usize>([u64; WORDS]);

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
    pub fn iter(&self) -> BitMembers<WORDS> {
        BitMembers { words: self.0, at: 0 }
    }

    /// Sum of the members' weights.
    pub fn weight<W: Copy + std::iter::Sum<W>>(&self, weights: &[W]) -> W {
        self.iter().map(|index| weights[index]).sum()
    }
}

/// The members of a set of fixed width.
pub struct BitMembers<const WORDS: usize> {
    words: [u64; WORDS],
    at: usize,
}

impl<const WORDS: usize> Iterator for BitMembers<WORDS> {
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
    type IntoIter = BitMembers<WORDS>;

    fn into_iter(self) -> BitMembers<WORDS> {
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
        let set: ObjectSet = [1000, 200, 3, 64, 63, 256].into_iter().collect();
        assert_eq!(set.iter().collect::<Vec<_>>(), [3, 63, 64, 200, 256, 1000]);
        assert_eq!(set.clone().into_iter().collect::<Vec<_>>(), [3, 63, 64, 200, 256, 1000]);
        assert_eq!(set.len(), 6);
        assert_eq!(set.without(3).smallest(), Some(63));
        assert!(ObjectSet::EMPTY.smallest().is_none());
    }

    #[test]
    fn set_algebra() {
        let a: ObjectSet = [1, 2, 100, 700].into_iter().collect();
        let b: ObjectSet = [2, 255, 300].into_iter().collect();
        assert_eq!(&a & &b, ObjectSet::EMPTY.with(2));
        assert_eq!((&a - &b).len(), 3);
        assert_eq!((&a | &b).iter().collect::<Vec<_>>(), [1, 2, 100, 255, 300, 700]);
        assert!((&a & &b).is_subset(&b) && !a.is_subset(&b) && !b.is_subset(&a));
        assert!((&a - &b).is_disjoint(&b) && !a.is_disjoint(&b));
        assert_eq!(a.weight(&(0..1000).collect::<Vec<usize>>()), 803);
    }

    #[test]
    fn sets_with_the_same_members_are_equal_however_they_came_about() {
        let small = ObjectSet::EMPTY.with(5);
        let mut grown = small.clone();
        grown.insert(2000);
        assert_ne!(grown, small);
        grown.remove(2000);
        assert_eq!(grown, small);
        assert_eq!(&small.with(900) - &ObjectSet::EMPTY.with(900), small);
        assert_eq!(&small.with(900) & &small, small);
        let mut extended = small.clone();
        extended.extend(&ObjectSet::EMPTY.with(900));
        assert_eq!(extended, small.with(900));
        assert!(ObjectSet::EMPTY.with(900).without(900).is_empty());
    }

    #[test]
    fn a_fixed_width_keeps_the_members_below_its_capacity() {
        let set: ObjectSet = [0, 63, 64, 1023].into_iter().collect();
        assert_eq!(set.bits::<1>().iter().collect::<Vec<_>>(), [0, 63]);
        assert_eq!(ObjectSet::from(set.bits::<16>()), set);
    }
}
