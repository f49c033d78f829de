//! A camera that answers an address with its present picture: network cameras, a phone, a script.
//!
//! In: the address of a PNG or JPEG, the camera's serial number as the configuration gives it, the lens from
//! a calibration. Out: frames with a count and a time of our own, for such an answer carries neither:
//! seconds since the camera was opened, at the moment the answer was there. Nothing distinguishes an old
//! picture from a new one but its content, and many such cameras keep their last picture for any client. So
//! each frame is the first picture that differs from the one that was kept when it was requested.

use crate::io::camera::http::Client;
use crate::io::camera::validator::{FrameValidator, content};
use crate::io::camera::{CameraError, CameraSource, Frame};
use cell_values::image::Image;
use cell_vision::camera::CameraModel;
use std::time::{Duration, Instant};

/// Between two requests for a picture that is not renewed yet.
const PAUSE: Duration = Duration::from_millis(20);

/// The camera at an address.
pub struct SnapshotCamera {
    address: String,
    serial: String,
    client: Client,
    /// How long a picture may stay the same.
    renewal: Duration,
    lens: Option<CameraModel>,
    opened: Instant,
    taken: u64,
    watch: FrameValidator,
}

impl SnapshotCamera {
    /// The camera at `address`; every request, and the renewal of the picture, may take up to `limit`.
    /// Connects to nothing yet.
    ///
    /// # Errors
    /// `OtherSerial` when the lens is another camera's.
    pub fn open(
        address: &str,
        serial: &str,
        limit: Duration,
        lens: Option<CameraModel>,
    ) -> Result<SnapshotCamera, CameraError> {
        super::same_serial(address, serial, lens.as_ref())?;
        Ok(SnapshotCamera {
            address: address.to_string(),
            serial: serial.to_string(),
            client: Client::new(limit),
            renewal: limit,
            lens,
            opened: Instant::now(),
            taken: 0,
            watch: FrameValidator::default(),
        })
    }

    fn picture(&self) -> Result<Image, CameraError> {
        let (_, bytes) = self.client.get(&self.address)?;
        Image::decode(&bytes).map_err(|source| CameraError::Picture { place: self.address.clone(), source })
    }

    /// The first picture after the one that the camera holds now.
    fn new_picture(&self) -> Result<Image, CameraError> {
        let requested = Instant::now();
        let kept = content(&self.picture()?);
        loop {
            let picture = self.picture()?;
            // One without noise shows nothing; what is wrong with its light is reported elsewhere.
            let reported = content(&picture);
            if reported.is_none() || reported != kept {
                return Ok(picture);
            }
            if requested.elapsed() >= self.renewal {
                let (address, within) = (self.address.clone(), self.renewal);
                return Err(CameraError::NotRenewed { address, within });
            }
            std::thread::sleep(PAUSE);
        }
    }
}

impl CameraSource for SnapshotCamera {
    fn intrinsics(&mut self) -> Result<CameraModel, CameraError> {
        let place = || self.address.clone();
        self.lens.clone().ok_or_else(|| CameraError::NoIntrinsics { place: place() })
    }

    fn grab(&mut self) -> Result<Frame, CameraError> {
        let image = self.new_picture()?;
        let source = self.address.clone();
        let time_s = self.opened.elapsed().as_secs_f64();
        let frame = Frame { image, sequence: self.taken, time_s, source, depth: None };
        self.taken += 1;
        self.watch.check(&frame, self.lens.as_ref())?;
        Ok(frame)
    }

    fn serial(&mut self) -> Result<String, CameraError> {
        Ok(self.serial.clone())
    }

    fn is_live(&self) -> bool {
        true
    }

    fn reopen(&mut self) -> Result<(), CameraError> {
        self.client = self.client.anew();
        self.watch.restarted();
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::io::camera::FaultKind;
    use crate::io::camera::http::tests::serve;

    fn answer(body: Vec<u8>) -> (String, Vec<u8>) {
        ("HTTP/1.1 200 OK\r\nContent-Type: image/jpeg\r\n".to_owned(), body)
    }

    fn jpeg(grey: u8) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut encoder = image::codecs::jpeg::JpegEncoder::new(&mut bytes);
        let picture = Image::filled(40, 32, [grey; 3]);
        encoder.encode(&picture.rgb, 40, 32, image::ExtendedColorType::Rgb8).unwrap();
        bytes
    }

    #[test]
    fn jpeg_snapshots_are_counted_and_what_the_camera_held_before_is_not_taken() {
        let cut = jpeg(70)[..60].to_vec();
        // What the camera held at the first question, twice; then each new picture once.
        let answers = [jpeg(40), jpeg(40), jpeg(50), jpeg(50), jpeg(60), jpeg(60), jpeg(60), cut];
        let address = serve(answers.map(answer).to_vec());
        let address = format!("{address}/snapshot.jpg");
        let mut camera = SnapshotCamera::open(&address, "door-7", Duration::from_secs(20), None).unwrap();
        let frame = camera.grab().unwrap();
        assert_eq!((frame.sequence, frame.image.width, frame.source.as_str()), (0, 40, address.as_str()));
        assert!(frame.image.rgb[0].abs_diff(50) < 3);
        let second = camera.grab().unwrap();
        assert!(second.sequence == 1 && second.time_s >= frame.time_s);
        assert!(second.image.rgb[0].abs_diff(60) < 3);
        camera.renewal = Duration::ZERO;
        let reported = camera.grab().unwrap_err();
        assert_eq!(reported.kind(), FaultKind::Repeated, "{reported}");
        assert!(matches!(camera.grab(), Err(CameraError::Picture { .. })));
        assert!(matches!(camera.grab(), Err(CameraError::Unreachable { .. })));
        assert_eq!(camera.serial().unwrap(), "door-7");
        assert!(matches!(camera.intrinsics(), Err(CameraError::NoIntrinsics { .. })));
    }

    #[test]
    fn the_lens_of_another_camera_or_size_is_refused() {
        let lens = CameraModel {
            serial: "door-7".into(),
            width: 80,
            height: 32,
            fx: 60.0,
            fy: 60.0,
            cx: 40.0,
            cy: 16.0,
            distortion: [0.0; 5],
        };
        let limit = Duration::from_secs(20);
        let other = SnapshotCamera::open("http://127.0.0.1:9/", "door-8", limit, Some(lens.clone()));
        assert!(matches!(other, Err(CameraError::OtherSerial { .. })));
        let address = serve([jpeg(50), jpeg(60)].map(answer).to_vec());
        let mut camera = SnapshotCamera::open(&address, "door-7", limit, Some(lens)).unwrap();
        assert!(matches!(camera.grab(), Err(CameraError::Model(_))));
    }
}
