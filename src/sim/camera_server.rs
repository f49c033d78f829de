//! The camera over HTTP: pictures and what the camera says about itself.
//!
//! In: `GET /frame.png` and `GET /intrinsics.json`. Out: a PNG with the headers `X-Sequence` (counts frames), `X-Time`
//! (controller seconds at exposure) and `X-Serial`; the factory intrinsics as JSON. Exposure is the moment the world is
//! copied; drawing happens afterwards on a blocking thread, without the world, one picture at a time. A camera that is
//! switched off (a fault) answers 503. Depth pictures do not exist yet.

use crate::sim::render::Renderer;
use crate::sim::render::lens::CameraTruth;
use crate::sim::world::spec::CameraMount;
use crate::sim::world::{SharedWorld, lock};
use axum::extract::State;
use axum::http::{HeaderName, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use axum::{Json, Router};
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};
use std::future::Future;
use std::sync::{Arc, OnceLock};
use tokio::net::TcpListener;
use tokio::sync::Mutex;

/// The camera that the server shows.
#[derive(Clone, Debug)]
pub struct CameraSetup {
    /// The lens and sensor that take the pictures.
    pub truth: CameraTruth,
    /// What `/intrinsics.json` says.
    pub reported: CameraTruth,
    /// Where it sits, true.
    pub mount: CameraMount,
}

struct Camera {
    setup: CameraSetup,
    world: SharedWorld,
    /// Made with the first picture: inverting the lens must not delay the start.
    renderer: OnceLock<Renderer>,
    /// Frames taken; held while one is drawn, so that several clients do not share out the processor.
    sequence: Mutex<u64>,
}

/// Serves clients until `stop` resolves; a request under way is finished first.
///
/// # Errors
/// The listener failed.
pub async fn serve(
    listener: TcpListener,
    setup: CameraSetup,
    world: SharedWorld,
    stop: impl Future<Output = ()> + Send + 'static,
) -> std::io::Result<()> {
    let camera = Camera { setup, world, renderer: OnceLock::new(), sequence: Mutex::new(0) };
    let router = Router::new()
        .route("/frame.png", get(frame))
        .route("/intrinsics.json", get(intrinsics))
        .with_state(Arc::new(camera));
    axum::serve(listener, router).with_graceful_shutdown(stop).await
}

async fn intrinsics(State(camera): State<Arc<Camera>>) -> Response {
    Json(camera.setup.reported.intrinsics()).into_response()
}

async fn frame(State(camera): State<Arc<Camera>>) -> Response {
    let mut sequence = camera.sequence.lock().await;
    if !lock(&camera.world).camera_on() {
        return (StatusCode::SERVICE_UNAVAILABLE, "the camera is off").into_response();
    }
    *sequence += 1;
    let number = *sequence;
    let drawing = camera.clone();
    let draw = move || {
        crate::io::priority::lower();
        drawing.take(number)
    };
    let drawn = tokio::task::spawn_blocking(draw).await;
    drop(sequence);
    match drawn {
        Ok(Ok((png, time_s))) => {
            let headers = [
                (header::CONTENT_TYPE, "image/png".to_string()),
                (header::CACHE_CONTROL, "no-store".to_string()),
                (HeaderName::from_static("x-sequence"), number.to_string()),
                (HeaderName::from_static("x-time"), format!("{time_s:.6}")),
                (HeaderName::from_static("x-serial"), camera.setup.truth.serial.clone()),
            ];
            (headers, png).into_response()
        }
        Ok(Err(error)) => (StatusCode::INTERNAL_SERVER_ERROR, error.to_string()).into_response(),
        Err(error) => (StatusCode::INTERNAL_SERVER_ERROR, error.to_string()).into_response(),
    }
}

impl Camera {
    /// Exposes, draws and encodes one frame; the PNG and the time of exposure.
    fn take(&self, number: u64) -> Result<(Vec<u8>, f64), image::ImageError> {
        let renderer = self.renderer.get_or_init(|| Renderer::new(self.setup.truth.clone()));
        let (scene, time_s, seed) = {
            let world = lock(&self.world);
            (world.scene(), world.now_s(), world.seed())
        };
        let table_from_camera = scene.table_from_camera(&self.setup.mount);
        let picture = renderer.render(&scene, &table_from_camera, seed, number);
        let mut png = Vec::with_capacity(picture.rgb.len());
        // Sensor noise leaves little to compress: the quick setting costs a tenth of the time and 10 % of the size.
        PngEncoder::new_with_quality(&mut png, CompressionType::Fast, FilterType::Sub).write_image(
            &picture.rgb,
            picture.width,
            picture.height,
            ExtendedColorType::Rgb8,
        )?;
        Ok((png, time_s))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::world::empty_world;
    use crate::sim::world::event::Fault;
    use nalgebra::Isometry3;
    use std::net::SocketAddr;

    fn setup() -> CameraSetup {
        let truth = CameraTruth::ideal("sim-77", 64, 36, 40.0);
        let mut reported = truth.clone();
        reported.fx = 40.01;
        CameraSetup { truth, reported, mount: CameraMount::Flange(Isometry3::identity()) }
    }

    async fn started() -> (SocketAddr, SharedWorld) {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let world = Arc::new(std::sync::Mutex::new(empty_world(5)));
        lock(&world).step(41.5, 0.002, &Isometry3::translation(0.0, 0.0, 0.5));
        tokio::spawn(serve(listener, setup(), world.clone(), std::future::pending()));
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
        lock(&world).apply_fault(&Fault::Camera { on: false }).unwrap();
        assert_eq!(fetch(address, "/frame.png").await.0, 503);
        lock(&world).apply_fault(&Fault::Camera { on: true }).unwrap();
        assert_eq!(fetch(address, "/frame.png").await.0, 200);
        assert_eq!(fetch(address, "/depth.png").await.0, 404);
    }
}
