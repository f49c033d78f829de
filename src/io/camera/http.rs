//! A camera behind an HTTP address: the simulator's, or any that speaks the same few words.
//!
//! `GET /frame.png` gives a picture with headers `X-Sequence` (whole number), `X-Time` (s) and `X-Serial`; `GET
//! /intrinsics.json` gives the fields of [`CameraModel`]; `GET /depth.png`, where there is one, gives depth aligned to the
//! picture (16 bits, 0.1 mm a unit) with the same headers. Every request has a time limit and the answer a size limit.

use crate::io::camera::watch::Watch;
use crate::io::camera::{CameraError, CameraSource, Frame};
use crate::vision::camera::CameraModel;
use crate::vision::image::depth::UNIT_M;
use crate::vision::image::{DepthImage, Image};
use std::time::Duration;

/// Largest answer read, bytes.
const ANSWER_MAX: u64 = 64 << 20;

/// The camera at an address.
pub struct HttpCamera {
    base: String,
    limit: Duration,
    agent: ureq::Agent,
    lens: Option<CameraModel>,
    watch: Watch,
    depth: Depth,
}

/// What is known of the camera's depth.
#[derive(Default)]
struct Depth {
    wanted: bool,
    /// The camera has said that it has none.
    absent: bool,
    /// Number of the last depth picture.
    last: Option<u64>,
}

impl HttpCamera {
    /// The camera at `base` (`http://host:port`); every request may take up to `limit`. Connects to nothing yet.
    pub fn new(base: &str, limit: Duration) -> HttpCamera {
        let config = ureq::Agent::config_builder()
            .timeout_global(Some(limit))
            .http_status_as_error(false)
            .max_redirects(0)
            .proxy(None)
            .build();
        HttpCamera {
            base: base.trim_end_matches('/').to_owned(),
            limit,
            agent: ureq::Agent::new_with_config(config),
            lens: None,
            watch: Watch::default(),
            depth: Depth::default(),
        }
    }

    /// Uses a lens from a calibration file instead of the camera's own; frames must then carry its serial number.
    pub fn with_lens(mut self, lens: CameraModel) -> HttpCamera {
        self.lens = Some(lens);
        self
    }

    /// The camera was restarted on purpose: its count may begin again.
    pub fn restarted(&mut self) {
        self.watch.forget();
        self.depth.last = None;
    }

    /// A new depth picture; `None` from a camera that has none.
    fn grab_depth(&mut self) -> Result<Option<DepthImage>, CameraError> {
        let address = format!("{}/depth.png", self.base);
        let (headers, bytes) = match self.get(&address) {
            Err(CameraError::Status { status: 404, .. }) => {
                self.depth.absent = true;
                return Ok(None);
            }
            answer => answer?,
        };
        let sequence = header(&headers, &address, "X-Sequence", "whole number")?;
        if let Some(last) = self.depth.last.replace(sequence).filter(|last| *last >= sequence) {
            return Err(CameraError::RepeatedSequence { place: address, sequence, last });
        }
        let depth = DepthImage::decode(&bytes, UNIT_M);
        depth.map(Some).map_err(|source| CameraError::Picture { place: address, source })
    }

    fn get(&self, address: &str) -> Result<(ureq::http::HeaderMap, Vec<u8>), CameraError> {
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

impl CameraSource for HttpCamera {
    fn intrinsics(&mut self) -> Result<CameraModel, CameraError> {
        if let Some(lens) = &self.lens {
            return Ok(lens.clone());
        }
        let address = format!("{}/intrinsics.json", self.base);
        let (_, bytes) = self.get(&address)?;
        let lens: CameraModel = serde_json::from_slice(&bytes)
            .map_err(|source| CameraError::Intrinsics { place: address, source })?;
        lens.check()?;
        self.lens = Some(lens.clone());
        Ok(lens)
    }

    fn grab(&mut self) -> Result<Frame, CameraError> {
        let address = format!("{}/frame.png", self.base);
        let (headers, bytes) = self.get(&address)?;
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
        if self.depth.wanted && !self.depth.absent {
            frame.depth = self.grab_depth()?;
        }
        Ok(frame)
    }

    fn want_depth(&mut self, wanted: bool) {
        self.depth.wanted = wanted;
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
mod tests {
    use super::*;
    use std::io::{Read, Write};
    use std::net::TcpListener;

    const LENS: &str = r#"{"serial": "7", "width": 40, "height": 32, "fx": 30, "fy": 30, "cx": 20, "cy": 16,
        "distortion": [0, 0, 0, 0, 0]}"#;

    /// Answers each request with the next of `answers` (status line and headers, body), then stops listening.
    fn serve(answers: Vec<(String, Vec<u8>)>) -> String {
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

    fn depth(sequence: u64, unit: u16) -> (String, Vec<u8>) {
        let picture = DepthImage::from_units(40, 32, &[unit; 40 * 32], UNIT_M).unwrap();
        (format!("HTTP/1.1 200 OK\r\nX-Sequence: {sequence}\r\n"), picture.encode_png(UNIT_M).unwrap())
    }

    #[test]
    fn depth_comes_with_the_picture_when_it_is_asked_for() {
        let answers = vec![picture(1, 1), picture(2, 2), depth(1, 4000), picture(3, 3), depth(1, 4000)];
        let mut camera = camera(answers);
        assert!(camera.grab().unwrap().depth.is_none());
        camera.want_depth(true);
        let frame = camera.grab().unwrap();
        assert!((frame.depth.unwrap().at(3, 3).unwrap() - 0.4).abs() < 1e-6);
        assert!(matches!(camera.grab(), Err(CameraError::RepeatedSequence { .. })), "frozen depth");
    }

    #[test]
    fn a_camera_without_depth_is_asked_once_and_one_that_fails_is_an_error() {
        let none = ("HTTP/1.1 404 Not Found\r\n".to_owned(), vec![]);
        let mut camera = camera(vec![picture(1, 1), none, picture(2, 2)]);
        camera.want_depth(true);
        assert!(camera.grab().unwrap().depth.is_none());
        assert_eq!(camera.grab().unwrap().sequence, 2);
        let busy = ("HTTP/1.1 503 Busy\r\n".to_owned(), vec![]);
        let mut camera = self::camera(vec![picture(1, 1), busy, picture(2, 2), picture(3, 3)]);
        camera.want_depth(true);
        assert!(matches!(camera.grab(), Err(CameraError::Status { status: 503, .. })));
        assert!(matches!(camera.grab(), Err(CameraError::Picture { .. })), "a colour picture is no depth");
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
