//! What a camera sends: configured, started, waited for, taken apart into pictures.
//!
//! In: what is wanted. Out: frames as bytes that were counted before they were read. As in `sdk`, every
//! call's error is looked at first; frames and lists free themselves.

use super::devices::{Context, Device};
use super::library::{Handle, Intrinsics, Pointer, STREAM_COLOUR, STREAM_DEPTH, Sdk, SdkError, c_text};
use super::profiles::{Stream, profile_at, stream_of, streams_in};
use std::ffi::{c_int, c_uint};
use std::path::Path;
use std::ptr::null_mut;

impl Sdk {
    /// What to play or stream.
    ///
    /// # Errors
    /// The SDK's.
    pub fn config(&self) -> Result<Config, SdkError> {
        let handle = self.own("rs2_create_config", self.functions.rs2_delete_config, |f, e| unsafe {
            (f.rs2_create_config)(e)
        })?;
        Ok(Config(handle))
    }

    /// What lays depth over colour, pixel by pixel.
    ///
    /// # Errors
    /// The SDK's.
    pub fn align_to_colour(&self) -> Result<Align, SdkError> {
        let f = &self.functions;
        let block = self.own("rs2_create_align", f.rs2_delete_processing_block, |f, e| unsafe {
            (f.rs2_create_align)(STREAM_COLOUR, e)
        })?;
        let queue = self.own("rs2_create_frame_queue", f.rs2_delete_frame_queue, |f, e| unsafe {
            (f.rs2_create_frame_queue)(1, e)
        })?;
        f.call(|f, e| unsafe { (f.rs2_start_processing_queue)(block.at(), queue.at(), e) })?;
        Ok(Align { block, queue })
    }
}

impl Context {
    /// A pipeline that is not running.
    ///
    /// # Errors
    /// The SDK's.
    pub fn pipeline(&self) -> Result<Pipeline, SdkError> {
        let delete = self.0.sdk.functions.rs2_delete_pipeline;
        let handle = self
            .0
            .child("rs2_create_pipeline", delete, |f, at, e| unsafe { (f.rs2_create_pipeline)(at, e) })?;
        Ok(Pipeline(handle))
    }
}

/// What a pipeline is to stream.
pub struct Config(Handle);

impl Config {
    /// The camera with this serial number.
    ///
    /// # Errors
    /// The SDK's.
    pub fn device(&self, serial: &str) -> Result<(), SdkError> {
        let serial = c_text(serial)?;
        self.0.call(|f, at, e| unsafe { (f.rs2_config_enable_device)(at, serial.as_ptr(), e) })
    }

    /// A recording, played once.
    ///
    /// # Errors
    /// The SDK's: a file that it cannot read.
    pub fn file(&self, path: &Path) -> Result<(), SdkError> {
        let path = c_text(&path.to_string_lossy())?;
        self.0.call(|f, at, e| unsafe {
            (f.rs2_config_enable_device_from_file_repeat_option)(at, path.as_ptr(), 0, e)
        })
    }

    /// A stream of this kind, size and rate.
    ///
    /// # Errors
    /// The SDK's.
    pub fn stream(&self, kind: c_int, format: c_int, size: [u32; 2], rate: u32) -> Result<(), SdkError> {
        let [width, height, rate] =
            [size[0], size[1], rate].map(|n| c_int::try_from(n).unwrap_or(c_int::MAX));
        self.0.call(|f, at, e| unsafe {
            (f.rs2_config_enable_stream)(at, kind, -1, width, height, format, rate, e)
        })
    }
}

/// What brings frames.
pub struct Pipeline(Handle);

impl Pipeline {
    /// Starts streaming.
    ///
    /// # Errors
    /// The SDK's: no such camera, a size it does not have, a camera that another program holds.
    pub fn start(&self, config: &Config) -> Result<Profile, SdkError> {
        let delete = self.0.sdk.functions.rs2_delete_pipeline_profile;
        let handle = self.0.child("rs2_pipeline_start_with_config", delete, |f, at, e| unsafe {
            (f.rs2_pipeline_start_with_config)(at, config.0.at(), e)
        })?;
        Ok(Profile(handle))
    }

    /// Stops streaming.
    ///
    /// # Errors
    /// The SDK's; a pipeline that does not run cannot be stopped.
    pub fn stop(&self) -> Result<(), SdkError> {
        self.0.call(|f, at, e| unsafe { (f.rs2_pipeline_stop)(at, e) })
    }

    /// The next set of frames, or nothing within the time.
    ///
    /// # Errors
    /// The SDK's.
    pub fn wait(&self, limit: std::time::Duration) -> Result<Option<Frames>, SdkError> {
        let limit_ms = c_uint::try_from(limit.as_millis()).unwrap_or(c_uint::MAX);
        let mut frames: Pointer = null_mut();
        let place = &raw mut frames;
        let came = self
            .0
            .call(|f, at, e| unsafe { (f.rs2_pipeline_try_wait_for_frames)(at, place, limit_ms, e) })?;
        if came == 0 || frames.is_null() {
            return Ok(None);
        }
        let release = self.0.sdk.functions.rs2_release_frame;
        Handle::new(&self.0.sdk, "rs2_pipeline_try_wait_for_frames", release, frames)
            .map(|handle| Some(Frames(handle)))
    }
}

/// What a pipeline streams.
pub struct Profile(Handle);

impl Profile {
    /// The camera.
    ///
    /// # Errors
    /// The SDK's.
    pub fn device(&self) -> Result<Device, SdkError> {
        let delete = self.0.sdk.functions.rs2_delete_device;
        let handle = self.0.child("rs2_pipeline_profile_get_device", delete, |f, at, e| unsafe {
            (f.rs2_pipeline_profile_get_device)(at, e)
        })?;
        Ok(Device(handle))
    }

    /// Its streams.
    ///
    /// # Errors
    /// The SDK's.
    pub fn streams(&self) -> Result<Vec<Stream>, SdkError> {
        let delete = self.0.sdk.functions.rs2_delete_stream_profiles_list;
        let list = self.0.child("rs2_pipeline_profile_get_streams", delete, |f, at, e| unsafe {
            (f.rs2_pipeline_profile_get_streams)(at, e)
        })?;
        let mut streams = streams_in(&list)?;
        for (index, stream) in streams.iter_mut().enumerate() {
            if !matches!(stream.kind, STREAM_COLOUR | STREAM_DEPTH) {
                continue;
            }
            let mut lens = Intrinsics::default();
            let place = &raw mut lens;
            let profile = profile_at(&list, index as c_int)?;
            // The profile belongs to the list, which lives until the end of this function.
            list.call(|f, _, e| unsafe { (f.rs2_get_video_stream_intrinsics)(profile.as_ptr(), place, e) })?;
            let [fx, fy, ppx, ppy] = [lens.fx, lens.fy, lens.ppx, lens.ppy];
            if stream.kind == STREAM_COLOUR
                && ![fx, fy, ppx, ppy].iter().chain(&lens.coefficients).all(|number| number.is_finite())
            {
                let what = format!("{lens:?}");
                return Err(SdkError::Nonsense { function: "rs2_get_video_stream_intrinsics", what });
            }
            stream.intrinsics = Some(lens);
        }
        Ok(streams)
    }
}

/// Frames of one moment.
pub struct Frames(Handle);

impl Frames {
    /// Each of them.
    ///
    /// # Errors
    /// The SDK's.
    pub fn all(&self) -> Result<Vec<Picture>, SdkError> {
        let count = self.0.call(|f, at, e| unsafe { (f.rs2_embedded_frames_count)(at, e) })?;
        let release = self.0.sdk.functions.rs2_release_frame;
        (0..count)
            .map(|index| {
                let handle = self.0.child("rs2_extract_frame", release, |f, at, e| unsafe {
                    (f.rs2_extract_frame)(at, index, e)
                })?;
                Ok(Picture(handle))
            })
            .collect()
    }
}

/// One frame.
pub struct Picture(Handle);

/// The rows of a frame without padding.
pub struct Rows {
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
    /// Bytes of the rows, one row after the other.
    pub data: Vec<u8>,
}

impl Picture {
    /// Kind and format of its stream.
    ///
    /// # Errors
    /// The SDK's.
    pub fn stream(&self) -> Result<Stream, SdkError> {
        // The profile lives as long as the frame.
        let profile = self.0.call(|f, at, e| unsafe { (f.rs2_get_frame_stream_profile)(at, e) })?;
        stream_of(&self.0.sdk, profile)
    }

    /// The camera's count.
    ///
    /// # Errors
    /// The SDK's.
    pub fn number(&self) -> Result<u64, SdkError> {
        self.0.call(|f, at, e| unsafe { (f.rs2_get_frame_number)(at, e) })
    }

    /// When it was taken, s, on the clock that the camera uses.
    ///
    /// # Errors
    /// The SDK's.
    pub fn time_s(&self) -> Result<f64, SdkError> {
        let time_ms = self.0.call(|f, at, e| unsafe { (f.rs2_get_frame_timestamp)(at, e) })?;
        if !time_ms.is_finite() {
            let what = format!("{time_ms} ms");
            return Err(SdkError::Nonsense { function: "rs2_get_frame_timestamp", what });
        }
        Ok(time_ms / 1e3)
    }

    /// Its rows, with `bytes` bytes a pixel.
    ///
    /// # Errors
    /// The SDK's, and sizes that do not fit each other.
    pub fn rows(&self, bytes: usize) -> Result<Rows, SdkError> {
        let width = self.0.call(|f, at, e| unsafe { (f.rs2_get_frame_width)(at, e) })?;
        let height = self.0.call(|f, at, e| unsafe { (f.rs2_get_frame_height)(at, e) })?;
        let stride = self.0.call(|f, at, e| unsafe { (f.rs2_get_frame_stride_in_bytes)(at, e) })?;
        let size = self.0.call(|f, at, e| unsafe { (f.rs2_get_frame_data_size)(at, e) })?;
        let data = self.0.call(|f, at, e| unsafe { (f.rs2_get_frame_data)(at, e) })?;
        let nonsense = || SdkError::Nonsense {
            function: "rs2_get_frame_data",
            what: format!("{size} bytes for {width} x {height} pixels in rows of {stride} bytes"),
        };
        let [w, h, row, size] = [width, height, stride, size].map(|n| usize::try_from(n).unwrap_or(0));
        let fits = w > 0 && h > 0 && row >= w * bytes && size >= row * (h - 1) + w * bytes;
        if !fits || data.is_null() {
            return Err(nonsense());
        }
        // The SDK promises `size` bytes there for as long as the frame lives, which is longer than this
        // function.
        let all = unsafe { std::slice::from_raw_parts(data.cast::<u8>(), size) };
        let rows = all.chunks(row).take(h).flat_map(|line| line.iter().take(w * bytes)).copied().collect();
        Ok(Rows { width: w as u32, height: h as u32, data: rows })
    }
}

/// What lays depth over colour.
pub struct Align {
    block: Handle,
    queue: Handle,
}

impl Align {
    /// The same frames with depth as the colour camera would see it.
    ///
    /// # Errors
    /// The SDK's, or that nothing came out.
    pub fn apply(&self, frames: Frames) -> Result<Frames, SdkError> {
        let set = frames.0;
        // The block takes over our reference, also when it fails: it must not be released again.
        let given = set.at();
        let sdk = set.sdk.clone();
        std::mem::forget(set);
        self.block.call(|f, at, e| unsafe { (f.rs2_process_frame)(at, given, e) })?;
        let mut aligned: Pointer = null_mut();
        let place = &raw mut aligned;
        self.queue.call(|f, at, e| unsafe { (f.rs2_try_wait_for_frame)(at, 1000, place, e) })?;
        Handle::new(&sdk, "rs2_try_wait_for_frame", sdk.functions.rs2_release_frame, aligned).map(Frames)
    }
}
