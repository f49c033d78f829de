//! The camera over HTTP: pictures and what the camera says about itself.
//!
//! In: `GET /frame.png`, `GET /depth.png` and `GET /intrinsics.json`. Out: a PNG with the headers
//! `X-Sequence` (counts frames of its kind), `X-Time` (controller seconds at exposure) and `X-Serial`; depth
//! with 16 bits, 0.1 mm a unit and 0 where nothing was found, aligned to the colour picture; the factory
//! intrinsics as JSON. A frame is exposed and transferred in its own time ([`crate::camera`]); drawing
//! happens afterwards on a blocking thread, without the world, one picture of a kind at a time, also when
//! the client of the last one has gone meanwhile; for clients that went while they waited nothing is
//! drawn. A camera that is switched off (a fault) answers 503; other faults of the camera are read from
//! the world at every frame.

use crate::camera::{CameraSetup, Window};
use crate::faults::link::Link;
use crate::render::Renderer;
use crate::robot_server::lateness::{Check, Lateness};
use crate::serve::MAX_CONNECTIONS;
use crate::serve::seats::Seats;
use crate::serve::stream::LinkListener;
use crate::world::{SharedWorld, lock};
use axum::body::Bytes;
use axum::extract::State;
use axum::http::{HeaderName, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use axum::{Json, Router};
use cell_edge::priority;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};
use std::future::Future;
use std::sync::{Arc, OnceLock};
use std::time::Duration;
use tokio::net::TcpListener;
use tokio::sync::Mutex;

/// How often a waiting request looks at the simulated time, and how long it does at most, wall time.
const LOOK_EVERY: Duration = Duration::from_micros(500);
const WAIT_LIMIT: Duration = Duration::from_secs(10);

/// Simulated time that drawing a picture may take; then that is held, wall time at most.
const DRAWN_WITHIN: Duration = Duration::from_millis(500);
const DRAWING_PATIENCE: Duration = Duration::from_secs(60);

struct Camera {
    setup: CameraSetup,
    world: SharedWorld,
    /// What of the simulator is late.
    lateness: Arc<Lateness>,
    /// Made with the first picture: inverting the lens must not delay the start.
    renderer: OnceLock<Renderer>,
    /// Frames taken, colour and depth; held while one is drawn, so that several clients do not share out the
    /// processor and its memory.
    rolls: [Arc<Mutex<Roll>>; 2],
}

/// What a frame shows.
#[derive(Clone, Copy)]
enum Kind {
    Colour,
    Depth,
}

/// What has been taken.
#[derive(Default)]
struct Roll {
    number: u64,
    last: Option<Frame>,
}

/// A frame as it is sent.
#[derive(Clone)]
struct Frame {
    png: Bytes,
    number: u64,
    time_s: f64,
}

/// Serves clients until `stop` resolves; a request under way is finished first.
///
/// # Errors
/// The listener failed.
pub async fn serve(
    listener: TcpListener,
    setup: CameraSetup,
    world: SharedWorld,
    (link, lateness): (Arc<Link>, Arc<Lateness>),
    stop: impl Future<Output = ()> + Send + 'static,
) -> std::io::Result<()> {
    let camera = Camera { setup, world, lateness, renderer: OnceLock::new(), rolls: Default::default() };
    let router = Router::new()
        .route("/frame.png", get(|camera| frame(camera, Kind::Colour)))
        .route("/depth.png", get(|camera| frame(camera, Kind::Depth)))
        .route("/intrinsics.json", get(intrinsics))
        .with_state(Arc::new(camera));
    let listener = LinkListener { listener, link, seats: Seats::new(MAX_CONNECTIONS) };
    axum::serve(listener, router).with_graceful_shutdown(stop).await
}

async fn intrinsics(State(camera): State<Arc<Camera>>) -> Response {
    if lock(&camera.world).camera_faults().off {
        return off();
    }
    Json(camera.setup.reported.intrinsics()).into_response()
}

fn off() -> Response {
    (StatusCode::SERVICE_UNAVAILABLE, "the camera is off").into_response()
}

async fn frame(State(camera): State<Arc<Camera>>, kind: Kind) -> Response {
    let mut roll = camera.rolls[kind as usize].clone().lock_owned().await;
    let (faults, now_s) = {
        let world = lock(&camera.world);
        (world.camera_faults().clone(), world.now_s())
    };
    if faults.off {
        return off();
    }
    if let Some(last) = roll.last.clone().filter(|_| faults.frozen) {
        return camera.answer(last);
    }
    roll.number += 1;
    let number = roll.number;
    if let Some(last) = roll.last.clone().filter(|_| faults.repeats) {
        let repeated = Frame { png: last.png, number, time_s: now_s };
        roll.last = Some(repeated.clone());
        return camera.answer(repeated);
    }
    let window = camera.setup.timing.window(now_s);
    camera.until(window.ready_s).await;
    let drawing = camera.clone();
    let at_work: Arc<Check> = Arc::new(|| true);
    camera.lateness.watch(&at_work, DRAWN_WITHIN, DRAWING_PATIENCE);
    // The thread has the roll, and not this request, which ends when its client goes.
    let draw = move || {
        // Frames go first. Where simulated time waits for the picture they need not, and beside other
        // programs the lowest priority would mean no picture for a minute.
        if drawing.lateness.is_followed() {
            priority::ordinary();
        } else {
            priority::lower();
        }
        let frame = drawing.take(kind, number, &window).map_err(|error| error.to_string());
        drop(at_work);
        roll.last = Some(frame.clone()?);
        frame
    };
    let taken = tokio::task::spawn_blocking(draw).await.unwrap_or_else(|error| Err(error.to_string()));
    match taken {
        Ok(frame) => camera.answer(frame),
        Err(error) => (StatusCode::INTERNAL_SERVER_ERROR, error).into_response(),
    }
}

impl Camera {
    fn answer(&self, frame: Frame) -> Response {
        let headers = [
            (header::CONTENT_TYPE, "image/png".to_string()),
            (header::CACHE_CONTROL, "no-store".to_string()),
            (HeaderName::from_static("x-sequence"), frame.number.to_string()),
            (HeaderName::from_static("x-time"), format!("{:.6}", frame.time_s)),
            (HeaderName::from_static("x-serial"), self.setup.truth.serial.clone()),
        ];
        (headers, frame.png).into_response()
    }

    /// Waits until the simulation has come so far, but not for too long: a test's world may not advance.
    async fn until(&self, time_s: f64) {
        let begun = tokio::time::Instant::now();
        while lock(&self.world).now_s() < time_s && begun.elapsed() < WAIT_LIMIT {
            tokio::time::sleep(LOOK_EVERY).await;
        }
    }

    /// Draws and encodes the frame of a window that is over.
    fn take(&self, kind: Kind, number: u64, window: &Window) -> Result<Frame, image::ImageError> {
        let renderer = self.renderer.get_or_init(|| Renderer::new(self.setup.truth.clone()));
        let moment = lock(&self.world).moment(&self.setup, window);
        let png = match kind {
            Kind::Colour => {
                let picture = moment.picture(renderer, number);
                encode(&picture.rgb, picture.width, picture.height, ExtendedColorType::Rgb8)?
            }
            Kind::Depth => {
                let depth = moment.depth(renderer, number);
                let bytes: Vec<u8> = depth.units.iter().flat_map(|unit| unit.to_ne_bytes()).collect();
                encode(&bytes, depth.width, depth.height, ExtendedColorType::L16)?
            }
        };
        let time_s = 0.5 * (window.begin_s + window.end_s);
        Ok(Frame { png: png.into(), number, time_s })
    }
}

/// Sensor noise leaves little to compress: the quick setting costs a tenth of the time and 10 % of the size.
fn encode(
    bytes: &[u8],
    width: u32,
    height: u32,
    colour: ExtendedColorType,
) -> Result<Vec<u8>, image::ImageError> {
    let mut png = Vec::with_capacity(bytes.len());
    PngEncoder::new_with_quality(&mut png, CompressionType::Fast, FilterType::Sub)
        .write_image(bytes, width, height, colour)?;
    Ok(png)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::CameraTiming;
    use crate::faults::camera::CameraFaults;
    use crate::render::lens::CameraTruth;
    use crate::world::empty_world;
    use crate::world::spec::CameraMount;
    use nalgebra::Isometry3;
    use std::net::SocketAddr;

    fn setup() -> CameraSetup {
        let truth = CameraTruth::ideal("sim-77", 64, 36, 40.0);
        let mut reported = truth.clone();
        reported.fx = 40.01;
        CameraSetup {
            truth,
            reported,
            mount: CameraMount::Flange(Isometry3::identity()),
            timing: CameraTiming::INSTANT,
        }
    }

    async fn started() -> (SocketAddr, SharedWorld) {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let world = Arc::new(std::sync::Mutex::new(empty_world(5)));
        lock(&world).step(41.5, 0.002, &Isometry3::translation(0.0, 0.0, 0.5));
        tokio::spawn(serve(listener, setup(), world.clone(), Default::default(), std::future::pending()));
        (address, world)
    }

    async fn fetch(address: SocketAddr, path: &str) -> (u16, Vec<(String, String)>, Vec<u8>) {
        let url = format!("http://{address}{path}");
        tokio::task::spawn_blocking(move || {
            let agent = ureq::Agent::new_with_config(
                ureq::config::Config::builder().http_status_as_error(false).build(),
            );
            let mut reply = agent.get(&url).call().unwrap();
            let headers = reply.headers().iter();
            let headers = headers.map(|(k, v)| (k.to_string(), v.to_str().unwrap().to_string())).collect();
            (reply.status().as_u16(), headers, reply.body_mut().read_to_vec().unwrap())
        })
        .await
        .unwrap()
    }

    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn frames_carry_time_serial_and_a_growing_number() {
        let (address, _world) = started().await;
        let mut pictures = Vec::new();
        for number in 1..=2 {
            let (status, headers, body) = fetch(address, "/frame.png").await;
            assert_eq!(status, 200);
            let value = |name: &str| headers.iter().find(|(k, _)| k == name).unwrap().1.clone();
            assert_eq!(value("x-sequence"), number.to_string());
            assert_eq!(value("x-time"), "41.500000");
            assert_eq!(value("x-serial"), "sim-77");
            let picture = image::load_from_memory(&body).unwrap().to_rgb8();
            assert_eq!(picture.dimensions(), (64, 36));
            pictures.push(picture.into_raw());
        }
        assert_ne!(pictures[0], pictures[1], "sensor noise never repeats");
    }

    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn a_picture_whose_client_has_gone_is_drawn_to_its_end_before_the_next() {
        let world = Arc::new(std::sync::Mutex::new(empty_world(5)));
        let camera = Arc::new(Camera {
            setup: setup(),
            world,
            lateness: Arc::default(),
            renderer: OnceLock::new(),
            rolls: Default::default(),
        });
        // What draws waits for the lens until the test lets go of it.
        let (begun, beginning) = std::sync::mpsc::channel();
        let (release, released) = std::sync::mpsc::channel::<()>();
        let holder = camera.clone();
        let lens = std::thread::spawn(move || {
            holder.renderer.get_or_init(|| {
                begun.send(()).unwrap();
                let _ = released.recv();
                Renderer::new(holder.setup.truth.clone())
            });
        });
        beginning.recv().unwrap();
        let free = || camera.rolls[0].try_lock().is_ok();
        let request = tokio::spawn(frame(State(camera.clone()), Kind::Colour));
        while free() {
            tokio::task::yield_now().await;
        }
        let waiting = tokio::spawn(frame(State(camera.clone()), Kind::Colour));
        for gone in [request, waiting] {
            gone.abort();
            assert!(gone.await.unwrap_err().is_cancelled());
        }
        assert!(!free(), "a second picture would be drawn beside the first");
        release.send(()).unwrap();
        lens.join().unwrap();
        while !free() {
            tokio::task::yield_now().await;
        }
        assert_eq!(camera.rolls[0].lock().await.number, 1, "nothing is drawn for who went while waiting");
    }

    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn connections_that_are_forgotten_shut_out_no_other() {
        let (address, _world) = started().await;
        let mut forgotten = Vec::new();
        for _ in 0..3 * MAX_CONNECTIONS {
            forgotten.push(tokio::net::TcpStream::connect(address).await.unwrap());
        }
        assert_eq!(fetch(address, "/intrinsics.json").await.0, 200);
    }

    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn intrinsics_are_the_reported_ones() {
        let (address, _world) = started().await;
        let (status, _, body) = fetch(address, "/intrinsics.json").await;
        let read: serde_json::Value = serde_json::from_slice(&body).unwrap();
        assert_eq!(
            (status, read["serial"].as_str(), read["fx"].as_f64()),
            (200, Some("sim-77"), Some(40.01))
        );
        assert_eq!(read["distortion"].as_array().unwrap().len(), 5);
        assert_eq!((read["width"].as_u64(), read["height"].as_u64()), (Some(64), Some(36)));
    }

    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn a_camera_that_is_off_says_so_and_comes_back() {
        let (address, world) = started().await;
        lock(&world).set_camera_faults(CameraFaults { off: true, ..CameraFaults::default() });
        assert_eq!(fetch(address, "/frame.png").await.0, 503);
        lock(&world).set_camera_faults(CameraFaults::default());
        assert_eq!(fetch(address, "/frame.png").await.0, 200);
    }

    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn depth_comes_in_tenths_of_a_millimetre_with_its_own_count() {
        let (address, world) = started().await;
        let (status, headers, body) = fetch(address, "/depth.png").await;
        assert_eq!(status, 200);
        let number = headers.iter().find(|(name, _)| name == "x-sequence").unwrap();
        assert_eq!(number.1, "1");
        let picture = image::load_from_memory(&body).unwrap();
        assert_eq!(picture.color(), image::ColorType::L16);
        assert_eq!((picture.width(), picture.height()), (64, 36));
        // The camera sits in the flange and looks along the gripper, away from the table: nothing farther
        // than 0.2 m.
        let units = picture.to_luma16().into_raw();
        assert!(units.iter().all(|unit| *unit < 2100) && units.contains(&0), "{:?}", units.iter().max());
        lock(&world).set_camera_faults(CameraFaults { off: true, ..CameraFaults::default() });
        assert_eq!(fetch(address, "/depth.png").await.0, 503);
        assert_eq!(fetch(address, "/missing.png").await.0, 404);
    }
}
