//! What could be read of an instance file, of whatever format, before it is whole.
//!
//! In: the pieces that `parse` and `public_data` have read, absent where they are wrong. Out: the
//! [`Instance`] if every piece is there, and the [`Layout`] by which arrangements are checked.

use crate::tabletop::arrangement::{Layout, Place};
use crate::tabletop::instance::{Instance, KeepOut, ObjectSpec, Workspace};

/// Most objects in one instance: every pair of starts is compared.
pub const MAX_OBJECTS: usize = 1000;

/// How a named shape's file is found: the name without `.json`; its text, if there is one.
pub type ShapeLookup<'a> = &'a dyn Fn(&str) -> Option<String>;

/// What could be read of a file: every part by itself, so that one fault does not hide others.
pub(crate) struct Parts {
    pub header: Header,
    pub objects: Vec<Option<ObjectSpec>>,
    pub places: Vec<Place>,
}

/// An instance without its objects; what could not be read is absent.
#[derive(Clone, Debug)]
pub struct Header {
    /// Where objects may lie.
    pub workspace: Option<Workspace>,
    /// Gap between objects, m.
    pub clearance: Option<f64>,
    /// Overlap taken as given, m.
    pub overlap_tolerance: Option<f64>,
    /// Regions to leave free.
    pub keep_out: Vec<Option<KeepOut>>,
}

impl Parts {
    /// The whole, if every part is there.
    pub(crate) fn instance(self) -> Option<Instance> {
        Some(Instance {
            workspace: self.header.workspace?,
            clearance: self.header.clearance?,
            overlap_tolerance: self.header.overlap_tolerance?,
            keep_out: self.header.keep_out.into_iter().collect::<Option<_>>()?,
            objects: self.objects.into_iter().collect::<Option<_>>()?,
        })
    }

    /// For the check of the arrangements.
    pub(crate) fn layout(&self) -> Layout<'_> {
        Layout {
            workspace: self.header.workspace,
            overlap_tolerance: self.header.overlap_tolerance,
            keep_out: &self.header.keep_out,
            objects: self.objects.iter().map(Option::as_ref).collect(),
            places: &self.places,
        }
    }
}
