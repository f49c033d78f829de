//! Cameras and sensors that the SDK knows: their names, settings, and what they can do.
//!
//! In: a context. Out: handles that free themselves and plain values. As in `sdk`, every call's error is
//! looked at first.

use super::library::{
    EXTENSION_DEPTH_SENSOR, Functions, Handle, PLAYBACK_STOPPED, STREAM_COLOUR, Sdk, SdkError, Version,
    text_at,
};
use super::profiles::streams_in;
use std::ffi::c_int;

impl Sdk {
    /// A context: what knows the cameras that are connected.
    ///
    /// # Errors
    /// The SDK's.
    pub fn context(&self) -> Result<Context, SdkError> {
        let Version { major, minor, patch } = self.version;
        let number = (major * 10_000 + minor * 100 + patch) as c_int;
        let handle = self.own("rs2_create_context", self.functions.rs2_delete_context, |f, e| unsafe {
            (f.rs2_create_context)(number, e)
        })?;
        Ok(Context(handle))
    }
}

/// What knows the cameras.
pub struct Context(pub(super) Handle);

impl Context {
    /// The cameras that are connected.
    ///
    /// # Errors
    /// The SDK's.
    pub fn devices(&self) -> Result<Vec<Device>, SdkError> {
        let functions = &self.0.sdk.functions;
        let list =
            self.0.child("rs2_query_devices", functions.rs2_delete_device_list, |f, at, e| unsafe {
                (f.rs2_query_devices)(at, e)
            })?;
        let count = list.call(|f, at, e| unsafe { (f.rs2_get_device_count)(at, e) })?;
        (0..count)
            .map(|index| {
                list.child("rs2_create_device", functions.rs2_delete_device, |f, at, e| unsafe {
                    (f.rs2_create_device)(at, index, e)
                })
                .map(Device)
            })
            .collect()
    }
}

/// A camera, live or played back.
pub struct Device(pub(super) Handle);

impl Device {
    /// One of the texts that the camera has about itself (`INFO_...`), if it has it.
    ///
    /// # Errors
    /// The SDK's.
    pub fn info(&self, what: c_int) -> Result<Option<String>, SdkError> {
        if self.0.call(|f, at, e| unsafe { (f.rs2_supports_device_info)(at, what, e) })? == 0 {
            return Ok(None);
        }
        // The text is the device's and is copied before anything else is requested of it.
        self.0.call(|f, at, e| unsafe { text_at((f.rs2_get_device_info)(at, what, e)) }).map(Some)
    }

    /// Restarts the camera; it is gone for some seconds.
    ///
    /// # Errors
    /// The SDK's.
    pub fn reset(&self) -> Result<(), SdkError> {
        self.0.call(|f, at, e| unsafe { (f.rs2_hardware_reset)(at, e) })
    }

    /// A recording is handed out frame by frame, however long we take for each.
    ///
    /// # Errors
    /// The SDK's; also for a camera that is no recording.
    pub fn play_every_frame(&self) -> Result<(), SdkError> {
        self.0.call(|f, at, e| unsafe { (f.rs2_playback_device_set_real_time)(at, 0, e) })
    }

    /// True when a recording is at its end.
    ///
    /// # Errors
    /// As [`Device::play_every_frame`].
    pub fn has_ended(&self) -> Result<bool, SdkError> {
        let status = self.0.call(|f, at, e| unsafe { (f.rs2_playback_device_get_current_status)(at, e) })?;
        Ok(status == PLAYBACK_STOPPED)
    }

    /// The camera's sensors.
    ///
    /// # Errors
    /// The SDK's.
    pub fn sensors(&self) -> Result<Vec<Sensor>, SdkError> {
        let functions = &self.0.sdk.functions;
        let list =
            self.0.child("rs2_query_sensors", functions.rs2_delete_sensor_list, |f, at, e| unsafe {
                (f.rs2_query_sensors)(at, e)
            })?;
        let count = list.call(|f, at, e| unsafe { (f.rs2_get_sensors_count)(at, e) })?;
        (0..count)
            .map(|index| {
                list.child("rs2_create_sensor", functions.rs2_delete_sensor, |f, at, e| unsafe {
                    (f.rs2_create_sensor)(at, index, e)
                })
                .map(Sensor)
            })
            .collect()
    }
}

/// A sensor of a camera.
pub struct Sensor(Handle);

impl Sensor {
    /// True when it measures depth.
    ///
    /// # Errors
    /// The SDK's.
    pub fn is_depth(&self) -> Result<bool, SdkError> {
        let is =
            |f: &Functions, at, e| unsafe { (f.rs2_is_sensor_extendable_to)(at, EXTENSION_DEPTH_SENSOR, e) };
        self.0.call(is).map(|yes| yes != 0)
    }

    /// Metres in a unit of depth.
    ///
    /// # Errors
    /// The SDK's; also for a sensor that measures no depth.
    pub fn depth_unit_m(&self) -> Result<f64, SdkError> {
        self.0.call(|f, at, e| unsafe { (f.rs2_get_depth_scale)(at, e) }).map(f64::from)
    }

    /// True when it takes the colour picture.
    ///
    /// # Errors
    /// The SDK's.
    pub fn gives_colour(&self) -> Result<bool, SdkError> {
        let delete = self.0.sdk.functions.rs2_delete_stream_profiles_list;
        let list = self.0.child("rs2_get_stream_profiles", delete, |f, at, e| unsafe {
            (f.rs2_get_stream_profiles)(at, e)
        })?;
        Ok(streams_in(&list)?.iter().any(|stream| stream.kind == STREAM_COLOUR))
    }

    /// True when it has this option.
    ///
    /// # Errors
    /// The SDK's.
    pub fn has(&self, option: c_int) -> Result<bool, SdkError> {
        self.0.call(|f, at, e| unsafe { (f.rs2_supports_option)(at, option, e) }).map(|yes| yes != 0)
    }

    /// Sets an option.
    ///
    /// # Errors
    /// The SDK's, also for a value outside the range.
    pub fn set(&self, option: c_int, value: f32) -> Result<(), SdkError> {
        self.0.call(|f, at, e| unsafe { (f.rs2_set_option)(at, option, value, e) })
    }

    /// The least and greatest value of an option.
    ///
    /// # Errors
    /// The SDK's.
    pub fn range(&self, option: c_int) -> Result<[f32; 2], SdkError> {
        let mut values = [0.0f32; 4];
        let [least, most, step, usual] = values.each_mut().map(std::ptr::from_mut);
        self.0
            .call(|f, at, e| unsafe { (f.rs2_get_option_range)(at, option, least, most, step, usual, e) })?;
        Ok([values[0], values[1]])
    }
}
