//! The marker families that the detector knows, by name, and how each of their markers is printed.
//!
//! In: a family's name and a marker's number. Out: [`Pattern`], the print as modules. Numbers and patterns
//! are the AprilTag C library's own, so that what is printed is what is looked for.

use std::fmt;
use std::str::FromStr;

/// A family of markers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Family {
    /// 16 data bits, Hamming distance 5: few and easily mistaken, for large modules from afar.
    Tag16h5,
    /// 25 data bits, distance 9.
    Tag25h9,
    /// 36 data bits, distance 11: the cell's own.
    Tag36h11,
    /// 41 data bits, data also outside the border.
    TagStandard41h12,
    /// 52 data bits, data also outside the border.
    TagStandard52h13,
    /// Round, 21 data bits.
    TagCircle21h7,
    /// Round, 49 data bits.
    TagCircle49h12,
    /// With a hole in the middle, 48 data bits.
    TagCustom48h12,
}

/// Every family with its name, in the order they are listed to people.
const NAMES: [(Family, &str); 8] = [
    (Family::Tag36h11, "tag36h11"),
    (Family::Tag25h9, "tag25h9"),
    (Family::Tag16h5, "tag16h5"),
    (Family::TagStandard41h12, "tagStandard41h12"),
    (Family::TagStandard52h13, "tagStandard52h13"),
    (Family::TagCircle21h7, "tagCircle21h7"),
    (Family::TagCircle49h12, "tagCircle49h12"),
    (Family::TagCustom48h12, "tagCustom48h12"),
];

/// Marker as printed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Pattern {
    /// Modules along an edge of the whole print.
    pub modules: usize,
    /// Modules along an edge of the square whose corners are detected: that edge is the marker's size.
    pub square_modules: usize,
    /// `modules * modules` values by rows from the top, true is white.
    pub white: Vec<bool>,
}

impl Pattern {
    /// True for a white module; outside the print everything is white.
    #[inline]
    pub fn is_white(&self, column: usize, row: usize) -> bool {
        column >= self.modules || self.white.get(row * self.modules + column).copied().unwrap_or(true)
    }

    /// Edge of the whole print for a marker of this size, m.
    #[inline]
    pub fn print_edge_m(&self, size_m: f64) -> f64 {
        size_m * self.modules as f64 / self.square_modules as f64
    }
}

/// Not the name of a family.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{name:?} is no marker family; one of: {}", known())]
pub struct UnknownFamily {
    /// What was given.
    pub name: String,
}

fn known() -> String {
    NAMES.map(|(_, name)| name).join(", ")
}

impl Family {
    /// All of them.
    pub fn all() -> impl Iterator<Item = Family> {
        NAMES.into_iter().map(|(family, _)| family)
    }

    /// As written in files and commands.
    pub fn name(self) -> &'static str {
        NAMES.into_iter().find(|(family, _)| *family == self).map_or("", |(_, name)| name)
    }

    /// Modules along an edge of the square whose corners are detected.
    pub fn square_modules(self) -> usize {
        match self {
            Family::Tag16h5 => 6,
            Family::Tag25h9 => 7,
            Family::Tag36h11 => 8,
            Family::TagStandard41h12 | Family::TagCircle21h7 => 5,
            Family::TagStandard52h13 | Family::TagCustom48h12 => 6,
            Family::TagCircle49h12 => 5,
        }
    }

    /// True when every module of the print is black or white by its number: not in round families and not in
    /// one with a hole.
    pub(super) fn is_full(self) -> bool {
        !matches!(self, Family::TagCircle21h7 | Family::TagCircle49h12 | Family::TagCustom48h12)
    }

    /// The library's own description of the family.
    pub(super) fn library(self) -> apriltag::Family {
        match self {
            Family::Tag16h5 => apriltag::Family::tag_16h5(),
            Family::Tag25h9 => apriltag::Family::tag_25h9(),
            Family::Tag36h11 => apriltag::Family::tag_36h11(),
            Family::TagStandard41h12 => apriltag::Family::tag_standard_41h12(),
            Family::TagStandard52h13 => apriltag::Family::tag_standard_52h13(),
            Family::TagCircle21h7 => apriltag::Family::tag_circle_21h7(),
            Family::TagCircle49h12 => apriltag::Family::tag_circle_49h12(),
            Family::TagCustom48h12 => apriltag::Family::tag_custom_48h12(),
        }
    }

    /// Marker `id` as printed; `None` if the family has no such number.
    pub fn pattern(self, id: u32) -> Option<Pattern> {
        with_raw(self, |family| {
            let count = family.ncodes;
            (id < count).then(|| drawn(family, id))
        })
    }

    /// How many markers the family has: numbers from 0 to one less.
    pub fn count(self) -> u32 {
        with_raw(self, |family| family.ncodes)
    }
}

/// Lends the C library's description of a family.
#[allow(unsafe_code)]
fn with_raw<T>(family: Family, read: impl FnOnce(&apriltag_sys::apriltag_family_t) -> T) -> T {
    use apriltag_sys as sys;
    type Create = unsafe extern "C" fn() -> *mut sys::apriltag_family_t;
    type Destroy = unsafe extern "C" fn(*mut sys::apriltag_family_t);
    let (create, destroy): (Create, Destroy) = match family {
        Family::Tag16h5 => (sys::tag16h5_create, sys::tag16h5_destroy),
        Family::Tag25h9 => (sys::tag25h9_create, sys::tag25h9_destroy),
        Family::Tag36h11 => (sys::tag36h11_create, sys::tag36h11_destroy),
        Family::TagStandard41h12 => (sys::tagStandard41h12_create, sys::tagStandard41h12_destroy),
        Family::TagStandard52h13 => (sys::tagStandard52h13_create, sys::tagStandard52h13_destroy),
        Family::TagCircle21h7 => (sys::tagCircle21h7_create, sys::tagCircle21h7_destroy),
        Family::TagCircle49h12 => (sys::tagCircle49h12_create, sys::tagCircle49h12_destroy),
        Family::TagCustom48h12 => (sys::tagCustom48h12_create, sys::tagCustom48h12_destroy),
    };
    // SAFETY: made here, read through a shared reference that ends with `read`, freed here by its own
    // function.
    unsafe {
        let raw = create();
        let answer = read(&*raw);
        destroy(raw);
        answer
    }
}

/// The marker as the C library draws it.
#[allow(unsafe_code)]
fn drawn(family: &apriltag_sys::apriltag_family_t, id: u32) -> Pattern {
    let modules = usize::try_from(family.total_width).unwrap_or(0);
    let mut white = Vec::with_capacity(modules * modules);
    // SAFETY: `id` is below the family's count (checked by the caller), the library only reads the family,
    // the image is made and freed here, and reading stays within its `total_width` rows of `stride` bytes.
    unsafe {
        let pointer = std::ptr::from_ref(family).cast_mut();
        let image = apriltag_sys::apriltag_to_image(pointer, id as i32);
        for row in 0..modules {
            let line = (*image).buf.add(row * (*image).stride as usize);
            white.extend((0..modules).map(|column| *line.add(column) > 127));
        }
        apriltag_sys::image_u8_destroy(image);
    }
    let square_modules = usize::try_from(family.width_at_border).unwrap_or(modules);
    Pattern { modules, square_modules, white }
}

impl fmt::Display for Family {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Family {
    type Err = UnknownFamily;

    fn from_str(text: &str) -> Result<Family, UnknownFamily> {
        let found = NAMES.into_iter().find(|(_, name)| name.eq_ignore_ascii_case(text));
        found.map(|(family, _)| family).ok_or_else(|| UnknownFamily { name: text.to_owned() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use cell_values::image::tag36h11;

    #[test]
    fn names_go_there_and_back_and_others_are_refused_with_the_known_ones() {
        for family in Family::all() {
            assert_eq!(family.name().parse(), Ok(family));
            assert_eq!(family.pattern(0).unwrap().square_modules, family.square_modules(), "{family}");
            assert!(family.pattern(family.count()).is_none());
        }
        assert!("aruco".parse::<Family>().unwrap_err().to_string().contains("tag25h9"));
    }

    #[test]
    fn the_table_of_the_simulated_camera_is_the_librarys() {
        assert_eq!(Family::Tag36h11.count(), tag36h11::COUNT);
        for id in 0..tag36h11::COUNT {
            let ours = tag36h11::tag36h11_bitmap(id).unwrap();
            let theirs = Family::Tag36h11.pattern(id).unwrap();
            assert!((0..100).all(|i| ours[i / 10][i % 10] == theirs.is_white(i % 10, i / 10)), "marker {id}");
        }
    }
}
