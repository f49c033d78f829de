//! `devices.camera`: which camera, what is requested of it, and when a picture of it is of no use.
//!
//! In: the located value and a decoder that collects complaints. Out: [`CameraDevice`] and the limits of a
//! usable picture. What is measured of a camera, its lens and its place, is in calibration files and not
//! here; size, rate and serial number are requested because a calibration holds for them alone.

use crate::io::camera::realsense::RealSenseSettings;
use crate::io::camera::{Exposure, UvcSettings};
use cell_parts::fields::{host, is_host, optional, path, port, required_number, required_positive};
use cell_values::image::quality::PictureLimits;
use rearrange::document::decode::{At, Decoder, Fields};
use std::path::{Path, PathBuf};

/// Where pictures come from.
#[derive(Clone, Debug, PartialEq)]
pub enum CameraDevice {
    /// The simulator's HTTP camera, `host:port`.
    Simulator {
        /// Host name or address.
        host: String,
        /// HTTP port.
        port: u16,
        /// Request depth too.
        depth: bool,
    },
    /// Any address that answers with its present picture.
    Http {
        /// The address, `http://...`.
        url: String,
        /// The camera's serial number.
        serial: String,
    },
    /// A RealSense camera or a recording of one.
    RealSense(RealSenseSettings),
    /// A USB camera.
    Uvc(UvcSettings),
    /// Pictures of a folder, in the order of their names.
    Folder {
        /// The folder.
        path: PathBuf,
    },
    /// A video file.
    Video {
        /// The file.
        path: PathBuf,
    },
}

impl CameraDevice {
    /// Where it is, for people.
    pub fn address(&self) -> String {
        match self {
            CameraDevice::Simulator { host, port, .. } => format!("{host}:{port}"),
            CameraDevice::Http { url, serial } => format!("{url}, serial {serial}"),
            CameraDevice::RealSense(RealSenseSettings { file: Some(file), .. }) => file.display().to_string(),
            CameraDevice::RealSense(RealSenseSettings { serial, .. }) => match serial {
                Some(serial) => format!("RealSense {serial}"),
                None => "the only RealSense connected".to_string(),
            },
            CameraDevice::Uvc(UvcSettings { device, serial, .. }) => {
                format!("{}, serial {serial}", device.display())
            }
            CameraDevice::Folder { path } | CameraDevice::Video { path } => path.display().to_string(),
        }
    }

    /// True for what shows a table of the past.
    pub fn is_recording(&self) -> bool {
        match self {
            CameraDevice::Folder { .. } | CameraDevice::Video { .. } => true,
            CameraDevice::RealSense(settings) => settings.file.is_some(),
            CameraDevice::Simulator { .. } | CameraDevice::Http { .. } | CameraDevice::Uvc(_) => false,
        }
    }

    /// True where depth comes with the pictures.
    pub fn measures_depth(&self) -> bool {
        match self {
            CameraDevice::Simulator { depth, .. } => *depth,
            CameraDevice::RealSense(settings) => settings.depth,
            CameraDevice::Http { .. }
            | CameraDevice::Uvc(_)
            | CameraDevice::Folder { .. }
            | CameraDevice::Video { .. } => false,
        }
    }

    /// True where the camera itself reports its lens.
    pub fn knows_its_lens(&self) -> bool {
        matches!(self, CameraDevice::Simulator { .. } | CameraDevice::RealSense(_))
    }

    /// The host it is reached at, if it is in a network.
    pub fn host(&self) -> Option<&str> {
        match self {
            CameraDevice::Simulator { host, .. } => Some(host),
            CameraDevice::Http { url, .. } => Some(host_of(url)),
            _ => None,
        }
    }
}

/// The host in `http://host:port/path`; brackets of an IPv6 address are left out.
fn host_of(url: &str) -> &str {
    let rest = url.strip_prefix("http://").unwrap_or(url);
    let authority = rest.split(['/', '?', '#']).next().unwrap_or_default();
    let authority = authority.rsplit_once('@').map_or(authority, |(_, host)| host);
    match authority.strip_prefix('[') {
        Some(bracketed) => bracketed.split(']').next().unwrap_or_default(),
        None => authority.split(':').next().unwrap_or_default(),
    }
}

const KINDS: [&str; 6] = ["simulator", "http", "realsense", "uvc", "folder", "video"];

/// Reads the camera and the limits of its pictures.
pub(super) fn camera_device(
    decoder: &mut Decoder,
    at: &At,
    folder: &Path,
) -> Option<(CameraDevice, PictureLimits)> {
    let open = decoder.open_map(at)?;
    let kind_at = open.required("kind", decoder)?;
    let kind = decoder.choice(&kind_at, &KINDS.map(|kind| (kind, kind)))?;
    let live = ["serial", "width", "height", "fps", "exposure_us"];
    let own: Vec<&str> = match kind {
        "simulator" => vec!["host", "port", "depth"],
        "http" => vec!["url", "serial"],
        "realsense" if open.optional("file").is_some() => vec!["file", "serial", "library", "depth"],
        "realsense" => [live.as_slice(), &["library", "depth"]].concat(),
        "uvc" => [live.as_slice(), &["device"]].concat(),
        _ => vec!["path"],
    };
    let known = [&["kind", "picture_limits"], own.as_slice()].concat();
    let fields = decoder.map(at, &known)?;
    let limits = optional(decoder, &fields, "picture_limits", PictureLimits::STANDARD, picture_limits);
    let depth =
        |decoder: &mut Decoder| optional(decoder, &fields, "depth", false, |decoder, at| decoder.boolean(at));
    let device = match kind {
        "simulator" => {
            let (host, port) = (host(decoder, &fields, "host"), port(decoder, &fields, "port"));
            CameraDevice::Simulator { depth: depth(decoder)?, host: host?, port: port? }
        }
        "http" => {
            let (url, serial) = (url(decoder, &fields), required_text(decoder, &fields, "serial"));
            CameraDevice::Http { url: url?, serial: serial? }
        }
        "realsense" => {
            let depth = depth(decoder);
            CameraDevice::RealSense(RealSenseSettings {
                depth: depth?,
                ..realsense(decoder, &fields, folder)?
            })
        }
        "uvc" => CameraDevice::Uvc(uvc(decoder, &fields)?),
        kind => {
            let path = fields.required("path", decoder).and_then(|at| path(decoder, &at, folder))?;
            if kind == "folder" { CameraDevice::Folder { path } } else { CameraDevice::Video { path } }
        }
    };
    Some((device, limits?))
}

fn realsense(decoder: &mut Decoder, fields: &Fields, folder: &Path) -> Option<RealSenseSettings> {
    let serial = optional(decoder, fields, "serial", None, |decoder, at| decoder.text(at).map(Some));
    let file = optional(decoder, fields, "file", None, |d, at| path(d, at, folder).map(Some));
    let library = optional(decoder, fields, "library", None, |d, at| path(d, at, folder).map(Some));
    let serial = serial?;
    let (file, library, depth) = (file?, library?, false);
    if file.is_some() {
        // A recording has its own size, rate and exposure.
        let (size, rate, exposure) = ([0; 2], 0, Exposure::Auto);
        return Some(RealSenseSettings { serial, file, library, size, rate, exposure, depth });
    }
    let StreamProfile { size, rate, exposure } = stream(decoder, fields)?;
    Some(RealSenseSettings { serial, file, library, size, rate, exposure, depth })
}

fn uvc(decoder: &mut Decoder, fields: &Fields) -> Option<UvcSettings> {
    let device = required_text(decoder, fields, "device").map(PathBuf::from);
    let serial = required_text(decoder, fields, "serial");
    let StreamProfile { size, rate, exposure } = stream(decoder, fields)?;
    Some(UvcSettings { device: device?, serial: serial?, size, rate, exposure })
}

/// What is requested of the pictures of a live camera.
struct StreamProfile {
    /// Width and height, pixels.
    size: [u32; 2],
    /// Pictures per second.
    rate: u32,
    /// Exposure.
    exposure: Exposure,
}

fn stream(decoder: &mut Decoder, fields: &Fields) -> Option<StreamProfile> {
    let mut count = |key: &str, range| {
        let at = fields.required(key, decoder)?;
        decoder.integer(&at, range).and_then(|value| u32::try_from(value).ok())
    };
    let (width, height) = (count("width", 16..=16_384), count("height", 16..=16_384));
    let rate = count("fps", 1..=300);
    let exposure = match fields.optional("exposure_us") {
        None => Some(Exposure::Auto),
        Some(_) => required_positive(decoder, fields, "exposure_us", 1e6, "us").map(Exposure::Fixed),
    };
    Some(StreamProfile { size: [width?, height?], rate: rate?, exposure: exposure? })
}

fn required_text(decoder: &mut Decoder, fields: &Fields, key: &str) -> Option<String> {
    let at = fields.required(key, decoder)?;
    decoder.text(&at)
}

fn url(decoder: &mut Decoder, fields: &Fields) -> Option<String> {
    let at = fields.required("url", decoder)?;
    let url = decoder.text(&at)?;
    if is_picture_address(&url) {
        return Some(url);
    }
    let help = "write http://HOST/PATH of a PNG or JPEG picture; encrypted addresses are not read";
    decoder.complain_at(&at, format!("{url:?} is not an address of a picture"), help);
    None
}

/// `http://[USER[:PASSWORD]@]HOST[:PORT]/PATH`, of visible ASCII characters.
fn is_picture_address(url: &str) -> bool {
    let Some(rest) = url.strip_prefix("http://") else { return false };
    let authority = rest.split(['/', '?', '#']).next().unwrap_or_default();
    let authority = authority.rsplit_once('@').map_or(authority, |(_, host)| host);
    let port = match authority.strip_prefix('[') {
        Some(bracketed) => bracketed.split_once(']').map(|(_, after)| after),
        None => authority.find(':').map_or(Some(""), |colon| authority.get(colon..)),
    };
    let port_is_sound = match port {
        Some("") => true,
        Some(port) => {
            port.strip_prefix(':').and_then(|port| port.parse().ok()).is_some_and(|port: u16| port != 0)
        }
        None => false,
    };
    url.chars().all(|c| c.is_ascii_graphic()) && is_host(host_of(url)) && port_is_sound
}

/// Each limit that is not given is the standard one.
fn picture_limits(decoder: &mut Decoder, at: &At) -> Option<PictureLimits> {
    let fields = decoder.map(at, &["light_min", "glare_max", "contrast_min", "edge_px_max"])?;
    let standard = PictureLimits::STANDARD;
    let mut number = |key: &str, usual: f64, range| match fields.optional(key) {
        None => Some(usual),
        Some(_) => required_number(decoder, &fields, key, range, ""),
    };
    let light = number("light_min", f64::from(standard.light_min), 0.0..=255.0);
    let glare_max = number("glare_max", standard.glare_max, 0.0..=1.0);
    let contrast = number("contrast_min", f64::from(standard.contrast_min), 0.0..=255.0);
    let edge_px_max = number("edge_px_max", standard.edge_px_max, 2.0..=1000.0);
    let (light_min, contrast_min) = (light? as u8, contrast? as u8);
    Some(PictureLimits { light_min, glare_max: glare_max?, contrast_min, edge_px_max: edge_px_max? })
}

#[cfg(test)]
mod tests {
    use super::*;
    use rearrange::document::parse;

    fn read(text: &str) -> Result<(CameraDevice, PictureLimits), String> {
        let node = parse(text, "cell.yaml").unwrap();
        let mut decoder = Decoder::new("cell.yaml");
        let found = camera_device(&mut decoder, &At::top(&node), Path::new("/cell"));
        decoder.finish(found).map_err(|complaints| complaints.to_string())
    }

    fn device(text: &str) -> CameraDevice {
        read(text).unwrap().0
    }

    #[test]
    fn every_kind_of_camera_can_be_chosen() {
        let realsense =
            device("{kind: realsense, serial: '1234', width: 1280, height: 720, fps: 15, depth: true}");
        let CameraDevice::RealSense(settings) = &realsense else { panic!("{realsense:?}") };
        assert_eq!(
            (settings.serial.as_deref(), settings.size, settings.rate),
            (Some("1234"), [1280, 720], 15)
        );
        assert!(settings.depth && settings.exposure == Exposure::Auto && settings.library.is_none());
        assert!(realsense.knows_its_lens() && !realsense.is_recording());
        let played = device("{kind: realsense, file: runs/a.bag, library: sdk/librealsense2.so}");
        assert!(played.is_recording());
        let CameraDevice::RealSense(settings) = played else { panic!() };
        assert_eq!(settings.file, Some(PathBuf::from("/cell/runs/a.bag")));
        assert_eq!(settings.library, Some(PathBuf::from("/cell/sdk/librealsense2.so")));
        let uvc = "{kind: uvc, device: /dev/v4l/by-id/cam, serial: A, width: 640, height: 480, fps: 30, exposure_us: 8000}";
        let CameraDevice::Uvc(settings) = device(uvc) else { panic!() };
        assert_eq!((settings.exposure, settings.serial.as_str()), (Exposure::Fixed(8000.0), "A"));
        let http = device("{kind: http, url: 'http://10.0.0.9:81/shot.jpg', serial: B}");
        assert_eq!(http.host(), Some("10.0.0.9"));
        assert_eq!(device("{kind: http, url: 'http://[::1]/a', serial: B}").host(), Some("::1"));
        let with = |url: &str| device(&format!("{{kind: http, url: '{url}', serial: B}}"));
        assert_eq!(with("http://user:secret@10.0.0.5/snap.jpg").host(), Some("10.0.0.5"));
        assert_eq!(with("http://cam?x=1").host(), Some("cam"));
        let sim = device("{kind: simulator, host: 127.0.0.2, port: 8090, depth: true}");
        assert!(matches!(sim, CameraDevice::Simulator { depth: true, .. }) && !sim.is_recording());
        assert!(device("{kind: folder, path: looks}").is_recording());
        assert!(device("{kind: video, path: look.avi}").is_recording());
    }

    #[test]
    fn limits_are_the_standard_ones_where_none_are_given() {
        let of = |limits: &str| read(&format!("{{kind: folder, path: a{limits}}}"));
        assert_eq!(of("").unwrap().1, PictureLimits::STANDARD);
        let limits = of(", picture_limits: {edge_px_max: 9, light_min: 20}").unwrap().1;
        assert_eq!((limits.edge_px_max, limits.light_min), (9.0, 20));
        assert_eq!(limits.glare_max, PictureLimits::STANDARD.glare_max);
        let reported = of(", picture_limits: {glare_max: 30, sharp: 1}").unwrap_err();
        assert!(reported.contains("glare_max") && reported.contains("sharp"), "{reported}");
    }

    #[test]
    fn what_is_missing_or_belongs_elsewhere_is_reported() {
        let reported = |text: &str| read(text).unwrap_err();
        assert!(reported("{kind: realsense, serial: '1'}").contains("width"));
        assert!(reported("{kind: realsense, file: a.bag, exposure_us: 10}").contains("exposure_us"));
        assert!(
            reported("{kind: uvc, device: /dev/video0, width: 1, height: 480, fps: 30}").contains("serial")
        );
        for wrong in [
            "https://x/a.jpg",
            "http://",
            "http:///a.jpg",
            "http://x y/a",
            "http://x:0/a",
            "http://x:99999/a",
            "http://[::1/a",
        ] {
            let found = reported(&format!("{{kind: http, url: '{wrong}', serial: a}}"));
            assert!(found.contains("http://HOST/PATH"), "{wrong}: {found}");
        }
        assert!(reported("{kind: reelsense}").contains("realsense"));
    }
}
