//! A camera that is looked after: every picture judged, every failure answered by the ladder, the fault
//! named at its end.
//!
//! In: a source and the limits of a usable picture. Out: a source that gives usable pictures or says what is
//! wrong. A recording is judged too, but there is nothing to restart about it.

use crate::io::camera::recovery::{Step, Tried, next};
use crate::io::camera::{CameraError, CameraSource, Frame};
use cell_values::image::quality::{PictureLimits, judge, measure};
use cell_vision::camera::CameraModel;
use std::time::{Duration, Instant};

/// No further step is begun after this long: the caller that waits for the picture has to get an answer.
const PATIENCE: Duration = Duration::from_secs(30);

/// A source under supervision.
pub struct MonitoredCamera {
    source: Box<dyn CameraSource>,
    limits: PictureLimits,
    pause: fn(Duration),
}

impl MonitoredCamera {
    /// Looks after `source`.
    pub fn new(source: Box<dyn CameraSource>, limits: PictureLimits) -> MonitoredCamera {
        MonitoredCamera { source, limits, pause: std::thread::sleep }
    }

    /// One picture, judged.
    fn usable(&mut self) -> Result<Frame, CameraError> {
        let frame = self.source.grab()?;
        match judge(&measure(&frame.image.gray()), &self.limits) {
            Ok(()) => Ok(frame),
            Err(fault) => Err(CameraError::Unusable { place: frame.source, sequence: frame.sequence, fault }),
        }
    }

    /// Carries a step out; its failure is the next fault.
    fn take(&mut self, step: Step) -> Result<(), CameraError> {
        match step {
            Step::Retry(pause) => (self.pause)(pause),
            Step::Reopen(pause) => {
                (self.pause)(pause);
                self.source.reopen()?;
            }
            Step::Reset => self.source.reset()?,
            Step::GiveUp => {}
        }
        Ok(())
    }
}

impl CameraSource for MonitoredCamera {
    fn intrinsics(&mut self) -> Result<CameraModel, CameraError> {
        self.source.intrinsics()
    }

    fn grab(&mut self) -> Result<Frame, CameraError> {
        let (mut tried, begun) = (Tried::default(), Instant::now());
        let mut attempt = self.usable();
        loop {
            let fault = match attempt {
                Err(fault) if self.source.is_live() => fault,
                done => return done,
            };
            let step = match begun.elapsed() < PATIENCE {
                true => next(fault.kind(), self.source.can_reset(), &tried),
                false => Step::GiveUp,
            };
            if step == Step::GiveUp {
                return Err(CameraError::GivenUp { tried: tried.to_string(), last: Box::new(fault) });
            }
            tracing::debug!(%fault, ?step, "camera");
            tried.count(step);
            attempt = self.take(step).and_then(|()| self.usable());
        }
    }

    fn glimpse(&mut self) -> Result<Frame, CameraError> {
        self.source.glimpse()
    }

    fn want_depth(&mut self, wanted: bool) {
        self.source.want_depth(wanted);
    }

    fn serial(&mut self) -> Result<String, CameraError> {
        self.source.serial()
    }

    fn is_live(&self) -> bool {
        self.source.is_live()
    }

    fn reopen(&mut self) -> Result<(), CameraError> {
        self.source.reopen()
    }

    fn can_reset(&self) -> bool {
        self.source.can_reset()
    }

    fn reset(&mut self) -> Result<(), CameraError> {
        self.source.reset()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::io::camera::FaultKind;
    use crate::io::camera::validator::FrameValidator;
    use cell_values::image::Image;
    use std::sync::{Arc, Mutex};

    /// What a made-up camera does at each request for a picture.
    #[derive(Clone, Copy, PartialEq)]
    enum Does {
        Good,
        Black,
        Unplugged,
        SameFrame,
        /// The same picture, with new numbers.
        SamePicture,
        OtherSerial,
    }

    struct MadeUp {
        does: Vec<Does>,
        live: bool,
        resets: bool,
        number: u64,
        shade: u8,
        watch: FrameValidator,
        log: Arc<Mutex<String>>,
    }

    impl CameraSource for MadeUp {
        fn intrinsics(&mut self) -> Result<CameraModel, CameraError> {
            Err(CameraError::NoIntrinsics { place: "made up".into() })
        }

        fn grab(&mut self) -> Result<Frame, CameraError> {
            self.log.lock().unwrap().push('g');
            let does = if self.does.len() > 1 { self.does.remove(0) } else { self.does[0] };
            let place = "made up".to_string();
            match does {
                Does::Unplugged => {
                    return Err(CameraError::Silent { place, limit: Duration::from_secs(1) });
                }
                Does::OtherSerial => {
                    let (found, wanted) = ("1".into(), "2".into());
                    return Err(CameraError::OtherSerial { address: place, found, wanted });
                }
                Does::SameFrame => {}
                Does::SamePicture => self.number += 1,
                Does::Good | Does::Black => {
                    self.number += 1;
                    self.shade = self.shade.wrapping_add(1);
                }
            }
            let mut image = Image::filled(64, 64, [if does == Does::Black { 3 } else { 180 }; 3]);
            (0..32 * 64).for_each(|i| image.set_pixel(16 + i % 32, i / 32, [self.shade % 20; 3]));
            let frame = Frame {
                image,
                sequence: self.number,
                time_s: self.number as f64,
                source: place,
                depth: None,
            };
            self.watch.check(&frame, None)?;
            Ok(frame)
        }

        fn is_live(&self) -> bool {
            self.live
        }

        fn reopen(&mut self) -> Result<(), CameraError> {
            self.log.lock().unwrap().push('o');
            self.watch.restarted();
            Ok(())
        }

        fn can_reset(&self) -> bool {
            self.resets
        }

        fn reset(&mut self) -> Result<(), CameraError> {
            self.log.lock().unwrap().push('X');
            Ok(())
        }
    }

    /// The camera, and what was requested of it.
    fn camera(does: &[Does], live: bool, resets: bool) -> (MonitoredCamera, Arc<Mutex<String>>) {
        let log = Arc::<Mutex<String>>::default();
        let (does, watch) = (does.to_vec(), FrameValidator::default());
        let source = MadeUp { does, live, resets, number: 0, shade: 0, watch, log: log.clone() };
        let mut camera = MonitoredCamera::new(Box::new(source), PictureLimits::STANDARD);
        camera.pause = |_| {};
        (camera, log)
    }

    fn requested(log: &Mutex<String>) -> String {
        std::mem::take(&mut *log.lock().unwrap())
    }

    #[test]
    fn a_camera_that_comes_back_is_taken_as_it_is() {
        let (mut camera, log) =
            camera(&[Does::Good, Does::Unplugged, Does::Unplugged, Does::Unplugged, Does::Good], true, true);
        assert_eq!(camera.grab().unwrap().sequence, 1);
        assert_eq!(camera.grab().unwrap().sequence, 2);
        assert_eq!(requested(&log), "ggggog");
    }

    #[test]
    fn each_fault_is_named_after_all_steps_and_ends_with_itself() {
        let cases = [
            (Does::Unplugged, FaultKind::Unplugged, "gggogogXgogog"),
            (Does::SameFrame, FaultKind::Frozen, "gggogogXgogog"),
            (Does::SamePicture, FaultKind::Repeated, "gggogogXgogog"),
            (Does::Black, FaultKind::Dark, "ggg"),
            (Does::OtherSerial, FaultKind::Misfit, "g"),
        ];
        for (does, kind, steps) in cases {
            let (mut camera, log) = camera(&[Does::Good, does], true, true);
            camera.grab().unwrap();
            requested(&log);
            let fault = camera.grab().unwrap_err();
            assert_eq!((fault.kind(), requested(&log).as_str()), (kind, steps));
        }
    }

    #[test]
    fn a_frozen_camera_is_frozen_at_the_second_requesting_too() {
        let (mut camera, log) = camera(&[Does::Good, Does::SameFrame], true, false);
        camera.grab().unwrap();
        requested(&log);
        for _ in 0..2 {
            let fault = camera.grab().unwrap_err();
            assert_eq!((fault.kind(), requested(&log).as_str()), (FaultKind::Frozen, "gggogog"));
            let CameraError::GivenUp { tried, .. } = fault else { panic!("{fault}") };
            assert_eq!(tried, "another picture 2 x, connected anew 2 x");
        }
    }

    #[test]
    fn recordings_are_judged_and_not_restarted() {
        let (mut camera, log) = camera(&[Does::Black, Does::Good], false, true);
        assert_eq!(camera.grab().unwrap_err().kind(), FaultKind::Dark);
        assert_eq!(camera.grab().unwrap().sequence, 2);
        assert_eq!(requested(&log), "gg");
    }
}
