//! A camera behind an HTTP address: the simulator's, or any that speaks the same few words.
//!
//! `GET /frame.png` gives a picture with headers `X-Sequence` (whole number), `X-Time` (s) and `X-Serial`;
//! `GET /intrinsics.json` gives the fields of [`CameraModel`]; `GET /depth.png`, where depth is requested,
//! 16 bits of 0.1 mm with a number of its own. Every request has a time limit and the answer a size limit.

use crate::io::camera::validator::FrameValidator;
use crate::io::camera::{CameraError, CameraSource, Frame};
use cell_values::image::Image;
use cell_values::image::depth::DepthImage;
use cell_values::image::depth::UNIT_M;
use cell_vision::camera::CameraModel;
use std::time::Duration;

/// Largest answer read, bytes.
const ANSWER_MAX: u64 = 64 << 20;

/// The camera at an address.
pub struct HttpCamera {
    base: String,
    client: Client,
    lens: Option<CameraModel>,
    depth: bool,
    /// Depth is of use now.
    wanted: bool,
    /// Number of the last depth picture.
    last_depth: Option<u64>,
    /// Connected to anew since: its count may begin again.
    depth_restarted: bool,
    watch: FrameValidator,
}

/// What requests bytes from an address.
pub(super) struct Client {
    limit: Duration,
    agent: ureq::Agent,
}

impl Client {
    /// Every request may take up to `limit`. Connects to nothing yet.
    pub(super) fn new(limit: Duration) -> Client {
        let config = ureq::Agent::config_builder()
            .timeout_global(Some(limit))
            .http_status_as_error(false)
            .max_redirects(0)
            .proxy(None)
            .build();
        Client { limit, agent: ureq::Agent::new_with_config(config) }
    }

    /// The same with no connection kept.
    pub(super) fn anew(&self) -> Client {
        Client::new(self.limit)
    }

    /// Headers and body at `address`.
    ///
    /// # Errors
    /// `Unreachable`, `Status`.
    pub(super) fn get(&self, address: &str) -> Result<(ureq::http::HeaderMap, Vec<u8>), CameraError> {
        let unreachable = |error: ureq::Error| CameraError::Unreachable {
            address: address.to_owned(),
            limit: self.limit,
            source: Box::new(error),
        };
        let mut answer = self.agent.get(address).call().map_err(unreachable)?;
        let status = answer.status().as_u16();
        if status != 200 {
            return Err(CameraError::Status { address: address.to_owned(), status });
        }
        let bytes = answer.body_mut().with_config().limit(ANSWER_MAX).read_to_vec().map_err(unreachable)?;
        Ok((answer.headers().clone(), bytes))
    }
}

impl HttpCamera {
    /// The camera at `base` (`http://host:port`); every request may take up to `limit`. Connects to nothing
    /// yet.
    pub fn new(base: &str, limit: Duration) -> HttpCamera {
        HttpCamera {
            base: base.trim_end_matches('/').to_owned(),
            client: Client::new(limit),
            lens: None,
            depth: false,
            wanted: true,
            last_depth: None,
            depth_restarted: false,
            watch: FrameValidator::default(),
        }
    }

    /// Uses a lens from a calibration file instead of the camera's own; frames must then carry its serial
    /// number.
    pub fn with_lens(mut self, lens: CameraModel) -> HttpCamera {
        self.lens = Some(lens);
        self
    }

    /// Requests the depth picture with every frame.
    pub fn with_depth(mut self) -> HttpCamera {
        self.depth = true;
        self
    }

    fn take_depth(&mut self) -> Result<DepthImage, CameraError> {
        let address = format!("{}/depth.png", self.base);
        let (headers, bytes) = self.client.get(&address)?;
        let sequence = header(&headers, &address, "X-Sequence", "whole number")?;
        let counts_on = |last: u64| sequence > last || self.depth_restarted && sequence != last;
        if let Some(last) = self.last_depth.filter(|last| !counts_on(*last)) {
            return Err(CameraError::RepeatedSequence { place: address, sequence, last });
        }
        let depth = DepthImage::decode(&bytes, UNIT_M);
        let depth = depth.map_err(|source| CameraError::Picture { place: address, source })?;
        (self.last_depth, self.depth_restarted) = (Some(sequence), false);
        Ok(depth)
    }
}

impl CameraSource for HttpCamera {
    fn intrinsics(&mut self) -> Result<CameraModel, CameraError> {
        if let Some(lens) = &self.lens {
            return Ok(lens.clone());
        }
        let address = format!("{}/intrinsics.json", self.base);
        let (_, bytes) = self.client.get(&address)?;
        let lens: CameraModel = serde_json::from_slice(&bytes)
            .map_err(|source| CameraError::Intrinsics { place: address, source })?;
        lens.check()?;
        self.lens = Some(lens.clone());
        Ok(lens)
    }

    fn grab(&mut self) -> Result<Frame, CameraError> {
        let address = format!("{}/frame.png", self.base);
        let (headers, bytes) = self.client.get(&address)?;
        let sequence = header(&headers, &address, "X-Sequence", "whole number")?;
        let time_s = header(&headers, &address, "X-Time", "number of seconds")?;
        let serial: String = header(&headers, &address, "X-Serial", "serial number")?;
        if let Some(lens) = &self.lens
            && lens.serial != serial
        {
            let wanted = lens.serial.clone();
            return Err(CameraError::OtherSerial { address, found: serial, wanted });
        }
        let image = Image::decode(&bytes)
            .map_err(|source| CameraError::Picture { place: address.clone(), source })?;
        let mut frame = Frame { image, sequence, time_s, source: address, depth: None };
        self.watch.check(&frame, self.lens.as_ref())?;
        if self.depth && self.wanted {
            frame.depth = Some(self.take_depth()?);
        }
        Ok(frame)
    }

    fn is_live(&self) -> bool {
        true
    }

    fn want_depth(&mut self, wanted: bool) {
        self.wanted = wanted;
    }

    fn reopen(&mut self) -> Result<(), CameraError> {
        self.client = self.client.anew();
        self.depth_restarted = true;
        self.watch.restarted();
        Ok(())
    }
}

fn header<T: std::str::FromStr>(
    headers: &ureq::http::HeaderMap,
    address: &str,
    name: &'static str,
    wanted: &'static str,
) -> Result<T, CameraError> {
    let found = headers.get(name).and_then(|value| value.to_str().ok()).unwrap_or_default();
    let broken = || CameraError::Header {
        address: address.to_owned(),
        name,
        found: found.chars().take(80).collect(),
        wanted,
    };
    if found.is_empty() { Err(broken()) } else { found.trim().parse().map_err(|_| broken()) }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use std::io::{Read, Write};
    use std::net::TcpListener;

    const LENS: &str = r#"{"serial": "7", "width": 40, "height": 32, "fx": 30, "fy": 30, "cx": 20, "cy": 16,
        "distortion": [0, 0, 0, 0, 0]}"#;

    /// Answers each request with the next of `answers` (status line and headers, body), then stops
    /// listening.
    pub fn serve(answers: Vec<(String, Vec<u8>)>) -> String {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = format!("http://{}", listener.local_addr().unwrap());
        std::thread::spawn(move || {
            for (head, body) in answers {
                let (mut stream, _) = listener.accept().unwrap();
                let mut request = Vec::new();
                let mut byte = [0];
                while !request.ends_with(b"\r\n\r\n") && stream.read(&mut byte).unwrap_or(0) == 1 {
                    request.push(byte[0]);
                }
                let head = format!("{head}Content-Length: {}\r\nConnection: close\r\n\r\n", body.len());
                let _ = stream.write_all(head.as_bytes()).and_then(|()| stream.write_all(&body));
            }
        });
        address
    }

    fn picture(sequence: u64, grey: u8) -> (String, Vec<u8>) {
        let head =
            format!("HTTP/1.1 200 OK\r\nX-Sequence: {sequence}\r\nX-Time: {sequence}.5\r\nX-Serial: 7\r\n");
        (head, Image::filled(40, 32, [grey; 3]).encode_png().unwrap())
    }

    fn text(body: &str) -> (String, Vec<u8>) {
        ("HTTP/1.1 200 OK\r\n".to_owned(), body.as_bytes().to_vec())
    }

    fn camera(answers: Vec<(String, Vec<u8>)>) -> HttpCamera {
        HttpCamera::new(&serve(answers), Duration::from_secs(20))
    }

    #[test]
    fn frames_come_with_number_time_and_source() {
        let mut camera = camera(vec![text(LENS), picture(3, 10), picture(4, 11)]);
        assert_eq!(camera.intrinsics().unwrap().serial, "7");
        let frame = camera.grab().unwrap();
        assert_eq!((frame.sequence, frame.time_s, frame.image.width), (3, 3.5, 40));
        assert!(frame.source.ends_with("/frame.png"));
        assert_eq!(camera.grab().unwrap().sequence, 4);
    }

    #[test]
    fn frozen_cameras_and_broken_answers_are_errors() {
        let cut = |mut answer: (String, Vec<u8>)| {
            answer.1.truncate(40);
            answer
        };
        let mut camera = camera(vec![
            picture(3, 10),
            picture(3, 11),
            picture(4, 10),
            cut(picture(5, 12)),
            ("HTTP/1.1 200 OK\r\nX-Time: 1\r\n".into(), vec![]),
            ("HTTP/1.1 503 Busy\r\n".into(), vec![]),
        ]);
        camera.grab().unwrap();
        assert!(matches!(camera.grab(), Err(CameraError::RepeatedSequence { .. })));
        assert!(matches!(camera.grab(), Err(CameraError::RepeatedPicture { .. })));
        assert!(matches!(camera.grab(), Err(CameraError::Picture { .. })));
        assert!(matches!(camera.grab(), Err(CameraError::Header { name: "X-Sequence", .. })));
        assert!(matches!(camera.grab(), Err(CameraError::Status { status: 503, .. })));
        let error = camera.grab().unwrap_err();
        assert!(matches!(error, CameraError::Unreachable { .. }));
        assert!(error.to_string().contains("celld sim") && error.to_string().contains("curl -I http://127"));
    }

    fn depth(sequence: u64) -> (String, Vec<u8>) {
        let depth = DepthImage::from_units(40, 32, &[4217; 40 * 32], UNIT_M).unwrap();
        (format!("HTTP/1.1 200 OK\r\nX-Sequence: {sequence}\r\n"), depth.encode_png(UNIT_M).unwrap())
    }

    #[test]
    fn depth_comes_with_the_picture_where_it_is_requested_and_a_wrong_or_old_one_is_an_error() {
        let (head, colour) = picture(9, 12);
        let answers = vec![
            picture(2, 9),
            picture(3, 10),
            depth(1),
            picture(4, 11),
            depth(1),
            picture(5, 12),
            (head, colour),
            picture(6, 13),
            depth(1),
            picture(7, 14),
            depth(0),
        ];
        let mut camera = camera(answers).with_depth();
        camera.want_depth(false);
        assert!(camera.grab().unwrap().depth.is_none());
        camera.want_depth(true);
        let frame = camera.grab().unwrap();
        assert!((frame.depth.unwrap().at(39, 31).unwrap() - 0.4217).abs() < 1e-6);
        let reported = camera.grab().unwrap_err();
        assert!(
            matches!(&reported, CameraError::RepeatedSequence { sequence: 1, last: 1, .. }),
            "frozen: {reported}"
        );
        let reported = camera.grab().unwrap_err();
        assert!(
            matches!(&reported, CameraError::Picture { place, .. } if place.ends_with("/depth.png")),
            "{reported}"
        );
        camera.reopen().unwrap();
        let reported = camera.grab().unwrap_err();
        assert!(
            matches!(reported, CameraError::RepeatedSequence { .. }),
            "frozen before and after: {reported}"
        );
        assert!(camera.grab().unwrap().depth.is_some(), "it began to count again");
    }

    #[test]
    fn the_wrong_camera_or_size_is_refused() {
        let mut camera = camera(vec![text(&LENS.replace("\"7\"", "\"8\"")), picture(1, 1)]);
        camera.intrinsics().unwrap();
        assert!(matches!(camera.grab(), Err(CameraError::OtherSerial { .. })));
        let mut camera = self::camera(vec![text(&LENS.replace("40", "41")), picture(1, 1)]);
        camera.intrinsics().unwrap();
        assert!(matches!(camera.grab(), Err(CameraError::Model(_))));
        let mut camera = self::camera(vec![text("{}"), text(&LENS.replace("30", "-30"))]);
        assert!(matches!(camera.intrinsics(), Err(CameraError::Intrinsics { .. })));
        assert!(matches!(camera.intrinsics(), Err(CameraError::Model(_))));
    }
}
