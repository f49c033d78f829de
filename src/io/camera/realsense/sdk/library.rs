//! The library itself: found, opened, its functions by their C names, and the one way to call them.
//!
//! In: where the library is, or nothing. Out: [`Sdk`], results instead of error pointers, and `Handle`,
//! which frees what the SDK made.

use libloading::Library;
use libloading::os::unix::{Library as UnixLibrary, RTLD_GLOBAL, RTLD_LOCAL, RTLD_NOW};
use serde::{Deserialize, Serialize};
use std::ffi::{CStr, CString, c_char, c_double, c_float, c_int, c_uint, c_ulonglong, c_void};
use std::path::{Path, PathBuf};
use std::ptr::{NonNull, null_mut};
use std::sync::Arc;

/// Oldest SDK that is taken: the first with the D405.
pub const OLDEST: Version = Version { major: 2, minor: 51, patch: 0 };
/// Newest minor version looked for by name when there is no plain `librealsense2.so`.
const NEWEST_MINOR: u32 = 80;

/// `rs2_stream`.
pub const STREAM_DEPTH: c_int = 1;
/// `rs2_stream`.
pub const STREAM_COLOUR: c_int = 2;
/// `rs2_format`: 16 bits of depth.
pub const FORMAT_Z16: c_int = 1;
/// `rs2_format`: red, green, blue.
pub const FORMAT_RGB8: c_int = 5;
/// `rs2_option`: exposure time.
pub const OPTION_EXPOSURE: c_int = 3;
/// `rs2_option`.
pub const OPTION_AUTO_EXPOSURE: c_int = 10;
/// `rs2_camera_info`.
pub const INFO_NAME: c_int = 0;
/// `rs2_camera_info`.
pub const INFO_SERIAL: c_int = 1;
/// `rs2_extension`.
pub(super) const EXTENSION_DEPTH_SENSOR: c_int = 7;
/// `rs2_playback_status`: all data was read.
pub(super) const PLAYBACK_STOPPED: c_int = 3;
/// `rs2_exception_type`.
const CAMERA_DISCONNECTED: c_int = 1;

/// A version of the SDK.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Version {
    /// 2.
    pub major: u32,
    /// 51 and up.
    pub minor: u32,
    /// Any.
    pub patch: u32,
}

impl Version {
    /// From the number that the library reports: 25901 is 2.59.1.
    pub fn of(number: u32) -> Version {
        Version { major: number / 10_000, minor: number / 100 % 100, patch: number % 100 }
    }
}

impl std::fmt::Display for Version {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}.{}.{}", self.major, self.minor, self.patch)
    }
}

/// Why the SDK cannot be used, or what it says.
#[derive(Debug, thiserror::Error)]
pub enum SdkError {
    /// Not there.
    #[error(
        "the RealSense SDK cannot be loaded ({tried}): install librealsense2 ({OLDEST} or newer), or name \
         its library in the camera's `library` key; the Python package pyrealsense2 carries one"
    )]
    Missing {
        /// What was tried, and what the loader said.
        tried: String,
    },
    /// There, but not the SDK.
    #[error(
        "{library} is no RealSense SDK: it has no {symbol}; name librealsense2.so in the camera's `library` \
         key"
    )]
    NotTheSdk {
        /// The file.
        library: String,
        /// What it lacks.
        symbol: String,
    },
    /// Too old, or of another generation.
    #[error("{library} is RealSense SDK {found}, celld needs {OLDEST} or a newer 2.x: install that")]
    Version {
        /// The file.
        library: String,
        /// Its version.
        found: Version,
    },
    /// The SDK refused a call.
    #[error("RealSense SDK: {message} ({function})")]
    Call {
        /// What it says.
        message: String,
        /// Its function.
        function: String,
        /// True when it says that the camera is gone.
        disconnected: bool,
    },
    /// The SDK broke its word.
    #[error("RealSense SDK: {function} gave {what}")]
    Nonsense {
        /// Its function.
        function: &'static str,
        /// What came.
        what: String,
    },
    /// A name with a zero byte in it.
    #[error("{text:?} cannot be handed to the RealSense SDK")]
    Text {
        /// The name.
        text: String,
    },
}

pub(super) type Pointer = *mut c_void;
pub(super) type ErrorPlace = *mut Pointer;
pub(super) type Delete = unsafe extern "C" fn(Pointer);

/// `rs2_intrinsics`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Intrinsics {
    /// Pixels per row.
    pub width: c_int,
    /// Rows.
    pub height: c_int,
    /// Principal point, column; 0 is the centre of the first pixel.
    pub ppx: c_float,
    /// Principal point, row.
    pub ppy: c_float,
    /// Focal length, pixels.
    pub fx: c_float,
    /// Focal length, pixels.
    pub fy: c_float,
    /// `rs2_distortion`.
    pub model: c_int,
    /// k1, k2, p1, p2, k3.
    pub coefficients: [c_float; 5],
}

/// The functions used, each under its C name.
macro_rules! functions {
    ($($name:ident($($argument:ty),*) $(-> $result:ty)?;)*) => {
        #[allow(non_snake_case)]
        pub(super) struct Functions { $(pub(super) $name: unsafe extern "C" fn($($argument),*) $(-> $result)?,)* }

        impl Functions {
            fn of(library: &Library, name: &str) -> Result<Functions, SdkError> {
                Ok(Functions {
                    $($name: {
                        let symbol = stringify!($name);
                        // Sound as long as the declaration below is the header's: the symbol is used as that
                        // type only.
                        let found = unsafe { library.get(format!("{symbol}\0").as_bytes()) };
                        *found.map_err(|_| SdkError::NotTheSdk {
                            library: name.to_string(), symbol: symbol.to_string(),
                        })?
                    },)*
                })
            }
        }
    };
}

functions! {
    rs2_get_api_version(ErrorPlace) -> c_int;
    rs2_get_error_message(Pointer) -> *const c_char;
    rs2_get_failed_function(Pointer) -> *const c_char;
    rs2_get_librealsense_exception_type(Pointer) -> c_int;
    rs2_free_error(Pointer);
    rs2_create_context(c_int, ErrorPlace) -> Pointer;
    rs2_delete_context(Pointer);
    rs2_query_devices(Pointer, ErrorPlace) -> Pointer;
    rs2_get_device_count(Pointer, ErrorPlace) -> c_int;
    rs2_create_device(Pointer, c_int, ErrorPlace) -> Pointer;
    rs2_delete_device_list(Pointer);
    rs2_delete_device(Pointer);
    rs2_supports_device_info(Pointer, c_int, ErrorPlace) -> c_int;
    rs2_get_device_info(Pointer, c_int, ErrorPlace) -> *const c_char;
    rs2_hardware_reset(Pointer, ErrorPlace);
    rs2_query_sensors(Pointer, ErrorPlace) -> Pointer;
    rs2_get_sensors_count(Pointer, ErrorPlace) -> c_int;
    rs2_create_sensor(Pointer, c_int, ErrorPlace) -> Pointer;
    rs2_delete_sensor_list(Pointer);
    rs2_delete_sensor(Pointer);
    rs2_is_sensor_extendable_to(Pointer, c_int, ErrorPlace) -> c_int;
    rs2_get_depth_scale(Pointer, ErrorPlace) -> c_float;
    rs2_get_stream_profiles(Pointer, ErrorPlace) -> Pointer;
    rs2_supports_option(Pointer, c_int, ErrorPlace) -> c_int;
    rs2_set_option(Pointer, c_int, c_float, ErrorPlace);
    rs2_get_option_range(Pointer, c_int, *mut c_float, *mut c_float, *mut c_float, *mut c_float, ErrorPlace);
    rs2_create_config(ErrorPlace) -> Pointer;
    rs2_delete_config(Pointer);
    rs2_config_enable_device(Pointer, *const c_char, ErrorPlace);
    rs2_config_enable_device_from_file_repeat_option(Pointer, *const c_char, c_int, ErrorPlace);
    rs2_config_enable_stream(Pointer, c_int, c_int, c_int, c_int, c_int, c_int, ErrorPlace);
    rs2_create_pipeline(Pointer, ErrorPlace) -> Pointer;
    rs2_delete_pipeline(Pointer);
    rs2_pipeline_start_with_config(Pointer, Pointer, ErrorPlace) -> Pointer;
    rs2_pipeline_stop(Pointer, ErrorPlace);
    rs2_pipeline_try_wait_for_frames(Pointer, *mut Pointer, c_uint, ErrorPlace) -> c_int;
    rs2_pipeline_profile_get_device(Pointer, ErrorPlace) -> Pointer;
    rs2_pipeline_profile_get_streams(Pointer, ErrorPlace) -> Pointer;
    rs2_delete_pipeline_profile(Pointer);
    rs2_get_stream_profiles_count(Pointer, ErrorPlace) -> c_int;
    rs2_get_stream_profile(Pointer, c_int, ErrorPlace) -> Pointer;
    rs2_delete_stream_profiles_list(Pointer);
    rs2_get_stream_profile_data(Pointer, *mut c_int, *mut c_int, *mut c_int, *mut c_int, *mut c_int, ErrorPlace);
    rs2_get_video_stream_intrinsics(Pointer, *mut Intrinsics, ErrorPlace);
    rs2_playback_device_set_real_time(Pointer, c_int, ErrorPlace);
    rs2_playback_device_get_current_status(Pointer, ErrorPlace) -> c_int;
    rs2_embedded_frames_count(Pointer, ErrorPlace) -> c_int;
    rs2_extract_frame(Pointer, c_int, ErrorPlace) -> Pointer;
    rs2_release_frame(Pointer);
    rs2_get_frame_stream_profile(Pointer, ErrorPlace) -> Pointer;
    rs2_get_frame_number(Pointer, ErrorPlace) -> c_ulonglong;
    rs2_get_frame_timestamp(Pointer, ErrorPlace) -> c_double;
    rs2_get_frame_width(Pointer, ErrorPlace) -> c_int;
    rs2_get_frame_height(Pointer, ErrorPlace) -> c_int;
    rs2_get_frame_stride_in_bytes(Pointer, ErrorPlace) -> c_int;
    rs2_get_frame_data_size(Pointer, ErrorPlace) -> c_int;
    rs2_get_frame_data(Pointer, ErrorPlace) -> *const c_void;
    rs2_create_align(c_int, ErrorPlace) -> Pointer;
    rs2_delete_processing_block(Pointer);
    rs2_create_frame_queue(c_int, ErrorPlace) -> Pointer;
    rs2_delete_frame_queue(Pointer);
    rs2_start_processing_queue(Pointer, Pointer, ErrorPlace);
    rs2_process_frame(Pointer, Pointer, ErrorPlace);
    rs2_try_wait_for_frame(Pointer, c_uint, *mut Pointer, ErrorPlace) -> c_int;
}

impl Functions {
    /// Makes a call and looks at its error before its result.
    pub(super) fn call<T>(&self, call: impl FnOnce(&Functions, ErrorPlace) -> T) -> Result<T, SdkError> {
        let mut error: Pointer = null_mut();
        let result = call(self, &raw mut error);
        if error.is_null() {
            return Ok(result);
        }
        // The pointer is an rs2_error that is ours until it is freed, once, below; its texts live as long.
        let failed = unsafe {
            let failed = SdkError::Call {
                message: text_at((self.rs2_get_error_message)(error)),
                function: text_at((self.rs2_get_failed_function)(error)),
                disconnected: (self.rs2_get_librealsense_exception_type)(error) == CAMERA_DISCONNECTED,
            };
            (self.rs2_free_error)(error);
            failed
        };
        Err(failed)
    }
}

/// Copies a C string; empty for a null pointer.
///
/// # Safety
/// `text` is null or points to a string that ends with a zero byte.
pub(super) unsafe fn text_at(text: *const c_char) -> String {
    if text.is_null() {
        return String::new();
    }
    unsafe { CStr::from_ptr(text) }.to_string_lossy().into_owned()
}

pub(super) fn c_text(text: &str) -> Result<CString, SdkError> {
    CString::new(text).map_err(|_| SdkError::Text { text: text.to_string() })
}

/// The loaded library.
#[derive(Clone)]
pub struct Sdk {
    pub(super) functions: Arc<Functions>,
    /// What the library says it is.
    pub version: Version,
}

impl std::fmt::Debug for Sdk {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "RealSense SDK {}", self.version)
    }
}

impl Sdk {
    /// Loads the library at `path`, or the installed one.
    ///
    /// # Errors
    /// `Missing`, `NotTheSdk`, `Version`; each says what to do.
    pub fn load(path: Option<&Path>) -> Result<Sdk, SdkError> {
        let names = path.map_or_else(installed_names, |path| vec![path.to_path_buf()]);
        let mut tried = Vec::new();
        for name in &names {
            match open(name) {
                Ok(library) => return Sdk::of(library, &name.display().to_string()),
                Err(reason) => tried.push(reason),
            }
        }
        // The plain name's reason says it for all the numbered ones.
        Err(SdkError::Missing { tried: tried.into_iter().next().unwrap_or_default() })
    }

    fn of(library: Library, name: &str) -> Result<Sdk, SdkError> {
        let functions = Functions::of(&library, name)?;
        // Never unloaded: the SDK keeps threads of its own that would run on in memory that is gone.
        std::mem::forget(library);
        let number = functions.call(|f, e| unsafe { (f.rs2_get_api_version)(e) })?;
        let version = Version::of(u32::try_from(number).unwrap_or(0));
        if version < OLDEST || version.major != OLDEST.major {
            return Err(SdkError::Version { library: name.to_string(), found: version });
        }
        Ok(Sdk { functions: Arc::new(functions), version })
    }

    pub(super) fn own(
        &self,
        function: &'static str,
        delete: Delete,
        make: impl FnOnce(&Functions, ErrorPlace) -> Pointer,
    ) -> Result<Handle, SdkError> {
        Handle::new(self, function, delete, self.functions.call(make)?)
    }
}

fn installed_names() -> Vec<PathBuf> {
    let numbered = (OLDEST.minor..=NEWEST_MINOR).rev().map(|minor| format!("librealsense2.so.2.{minor}"));
    std::iter::once("librealsense2.so".to_string()).chain(numbered).map(PathBuf::from).collect()
}

/// Opens a shared object. The one of the Python package needs the interpreter's symbols; they are loaded,
/// never used.
fn open(path: &Path) -> Result<Library, String> {
    let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    if let Some(python) = python_of(&name) {
        // Loading runs the library's initialisers: it is the interpreter, installed by the system.
        let loaded = unsafe { UnixLibrary::open(Some(&python), RTLD_NOW | RTLD_GLOBAL) };
        std::mem::forget(loaded.map_err(|error| format!("{error}, which {name} needs"))?);
    }
    // Loading runs the initialisers of the file that the configuration names as the SDK.
    let library = unsafe { UnixLibrary::open(Some(path), RTLD_NOW | RTLD_LOCAL) };
    library.map(Library::from).map_err(|error| error.to_string())
}

/// `libpython3.11.so.1.0` for `pyrealsense2.cpython-311-x86_64-linux-gnu.so`.
fn python_of(name: &str) -> Option<String> {
    let (_, rest) = name.strip_prefix("pyrealsense2")?.split_once("cpython-3")?;
    let minor: String = rest.chars().take_while(char::is_ascii_digit).collect();
    (!minor.is_empty()).then(|| format!("libpython3.{minor}.so.1.0"))
}

/// Something of the SDK's that is ours to free.
pub(super) struct Handle {
    pub(super) sdk: Sdk,
    pointer: NonNull<c_void>,
    delete: Delete,
}

// The SDK lets any thread use its handles; a `Handle` is used by one at a time, for it is neither copied nor
// shared.
unsafe impl Send for Handle {}

impl Handle {
    pub(super) fn new(
        sdk: &Sdk,
        function: &'static str,
        delete: Delete,
        pointer: Pointer,
    ) -> Result<Handle, SdkError> {
        let pointer = NonNull::new(pointer)
            .ok_or_else(|| SdkError::Nonsense { function, what: "nothing".to_string() })?;
        Ok(Handle { sdk: sdk.clone(), pointer, delete })
    }

    pub(super) fn at(&self) -> Pointer {
        self.pointer.as_ptr()
    }

    pub(super) fn call<T>(
        &self,
        call: impl FnOnce(&Functions, Pointer, ErrorPlace) -> T,
    ) -> Result<T, SdkError> {
        let pointer = self.at();
        self.sdk.functions.call(|functions, error| call(functions, pointer, error))
    }

    pub(super) fn child(
        &self,
        function: &'static str,
        delete: Delete,
        make: impl FnOnce(&Functions, Pointer, ErrorPlace) -> Pointer,
    ) -> Result<Handle, SdkError> {
        Handle::new(&self.sdk, function, delete, self.call(make)?)
    }
}

impl Drop for Handle {
    fn drop(&mut self) {
        // Ours, freed once, by the function that belongs to its kind.
        unsafe { (self.delete)(self.at()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn versions_and_interpreters_are_read_from_numbers_and_names() {
        assert_eq!(Version::of(25_901).to_string(), "2.59.1");
        assert!(Version::of(25_003) < OLDEST && Version::of(25_605) > OLDEST);
        let name = "pyrealsense2.cpython-311-x86_64-linux-gnu.so";
        assert_eq!(python_of(name).as_deref(), Some("libpython3.11.so.1.0"));
        assert_eq!(python_of("librealsense2.so.2.59"), None);
    }

    #[test]
    fn what_is_not_there_or_not_the_sdk_is_reported_with_the_remedy() {
        let missing = Sdk::load(Some(Path::new("no/such/librealsense2.so"))).unwrap_err().to_string();
        assert!(
            missing.contains("no/such/librealsense2.so") && missing.contains("install librealsense2"),
            "{missing}"
        );
        let other = Sdk::load(Some(Path::new("libc.so.6"))).unwrap_err();
        assert!(
            matches!(&other, SdkError::NotTheSdk { symbol, .. } if symbol == "rs2_get_api_version"),
            "{other}"
        );
    }
}
