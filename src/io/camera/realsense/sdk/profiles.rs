//! What a stream is: its kind, format, rate and lens, as the SDK lists it.
//!
//! In: a list of profiles, or one that is alive. Out: plain values.

use super::library::{Handle, Intrinsics, Pointer, Sdk, SdkError};
use std::ffi::{c_int, c_void};
use std::ptr::NonNull;

/// One stream of a profile.
#[derive(Clone, Debug, PartialEq)]
pub struct Stream {
    /// `STREAM_...`.
    pub kind: c_int,
    /// `FORMAT_...`.
    pub format: c_int,
    /// Frames a second.
    pub rate: u32,
    /// Lens and size, of streams of pictures.
    pub intrinsics: Option<Intrinsics>,
}

pub(super) fn profile_at(list: &Handle, index: c_int) -> Result<NonNull<c_void>, SdkError> {
    let function = "rs2_get_stream_profile";
    let profile = list.call(|f, at, e| unsafe { (f.rs2_get_stream_profile)(at, index, e) })?;
    NonNull::new(profile).ok_or_else(|| SdkError::Nonsense { function, what: "nothing".to_string() })
}

/// The streams of a list of profiles.
pub(super) fn streams_in(list: &Handle) -> Result<Vec<Stream>, SdkError> {
    let count = list.call(|f, at, e| unsafe { (f.rs2_get_stream_profiles_count)(at, e) })?;
    (0..count)
        .map(|index| {
            let profile = profile_at(list, index)?;
            // The profile belongs to the list.
            stream_of(&list.sdk, profile.as_ptr())
        })
        .collect()
}

/// Kind and format of a profile that is alive.
pub(super) fn stream_of(sdk: &Sdk, profile: Pointer) -> Result<Stream, SdkError> {
    let mut values: [c_int; 5] = [0; 5];
    let [kind, format, index, id, rate] = values.each_mut().map(std::ptr::from_mut);
    sdk.functions
        .call(|f, e| unsafe { (f.rs2_get_stream_profile_data)(profile, kind, format, index, id, rate, e) })?;
    let rate = u32::try_from(values[4]).unwrap_or(0);
    Ok(Stream { kind: values[0], format: values[1], rate, intrinsics: None })
}
