//! What a client of the camera sees of faults.

use super::*;

struct Shot {
    status: u16,
    number: String,
    png: Vec<u8>,
}

impl Shot {
    fn levels(&self) -> Vec<f64> {
        let picture = image::load_from_memory(&self.png).unwrap().to_luma8();
        picture.into_raw().into_iter().map(f64::from).collect()
    }

    fn mean(&self) -> f64 {
        let levels = self.levels();
        levels.iter().sum::<f64>() / levels.len() as f64
    }

    fn spread(&self) -> f64 {
        let (levels, mean) = (self.levels(), self.mean());
        (levels.iter().map(|level| (level - mean).powi(2)).sum::<f64>() / levels.len() as f64).sqrt()
    }

    /// Mean difference between neighbours in a row.
    fn sharpness(&self) -> f64 {
        let levels = self.levels();
        levels.windows(2).map(|pair| (pair[1] - pair[0]).abs()).sum::<f64>() / levels.len() as f64
    }

    fn difference(&self, other: &Shot) -> f64 {
        let (a, b) = (self.levels(), other.levels());
        a.iter().zip(&b).map(|(a, b)| (a - b).abs()).sum::<f64>() / a.len() as f64
    }
}

impl Bench {
    async fn shot(&self) -> Shot {
        let url = format!("http://{}/frame.png", self.sim.addresses.camera);
        let fetch = move || {
            let agent = ureq::Agent::new_with_config(
                ureq::config::Config::builder().http_status_as_error(false).build(),
            );
            let mut reply = agent.get(&url).call().unwrap();
            let number = reply.headers().get("x-sequence");
            let number = number.map(|value| value.to_str().unwrap().to_owned()).unwrap_or_default();
            Shot { status: reply.status().as_u16(), number, png: reply.body_mut().read_to_vec().unwrap() }
        };
        tokio::task::spawn_blocking(fetch).await.unwrap()
    }

    /// The picture with this fault alone.
    async fn with(&self, fault: &str) -> Shot {
        self.fault(fault);
        let shot = self.shot().await;
        self.fault("{do: clear}");
        shot
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_camera_is_off_frozen_or_repeats_itself() {
    let bench = bench("").await;
    let good = bench.shot().await;
    bench.fault("{do: camera.off}");
    assert_eq!(bench.shot().await.status, 503);
    bench.fault("{do: camera.on}");
    bench.fault("{do: camera.freeze}");
    let frozen = bench.shot().await;
    assert!(frozen.png == good.png && frozen.number == good.number);
    bench.fault("{do: clear}");
    bench.fault("{do: camera.repeat}");
    let repeated = bench.shot().await;
    assert!(repeated.png == good.png && repeated.number != good.number);
    bench.fault("{do: clear}");
    let next = bench.shot().await;
    assert!(next.png != good.png && next.number != good.number, "noise never repeats");
    bench.sim.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn pictures_are_dark_blurred_foggy_or_from_elsewhere() {
    let bench = bench("").await;
    let good = bench.shot().await;
    let dark = bench.with("{do: camera.gain, args: {gain: 0.1}}").await;
    assert!((dark.mean() / good.mean() - 0.1).abs() < 0.02, "{} {}", dark.mean(), good.mean());
    let bright = bench.with("{do: camera.gain, args: {gain: 50}}").await;
    assert!(bright.levels().iter().filter(|level| **level > 254.0).count() > 96 * 72 / 2);
    let blurred = bench.with("{do: camera.blur, args: {sigma_px: 4}}").await;
    assert!(blurred.sharpness() < 0.5 * good.sharpness(), "{} {}", blurred.sharpness(), good.sharpness());
    assert!((blurred.mean() / good.mean() - 1.0).abs() < 0.05);
    let foggy = bench.with("{do: camera.fog, args: {share: 0.8}}").await;
    assert!(foggy.spread() < 0.4 * good.spread(), "{} {}", foggy.spread(), good.spread());
    let still = bench.shot().await.difference(&good);
    let bumped =
        bench.with("{do: camera.extrinsics, args: {translation_m: [0.01, 0, 0], rotation_deg: [0, 0, 5]}}");
    assert!(bumped.await.difference(&good) > 2.0 * still + 1.0);
    assert!(bench.shot().await.difference(&good) < 2.0 * still, "cleared");
    bench.sim.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_camera_that_drifts_moves_further_with_time() {
    let bench = bench("").await;
    let shift = |sim: &RunningSim| lock(&sim.world()).camera_faults().shift.translation.vector.x;
    bench.fault("{do: camera.drift, args: {translation_m: [0.06, 0, 0]}}");
    bench.until("a millimetre", |sim| shift(sim) > 0.001).await;
    bench.until("three", |sim| shift(sim) > 0.003).await;
    let (seconds, moved) = (bench.step() as f64 / 500.0, shift(&bench.sim));
    assert!(moved <= 0.001 * seconds, "{moved} m in at most {seconds} s");
    bench.fault("{do: clear}");
    assert_eq!(shift(&bench.sim), 0.0);
    bench.sim.shutdown().await;
}
