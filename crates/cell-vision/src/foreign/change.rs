//! What changed on the table since it was empty, for cameras without depth.
//!
//! In: pictures of the empty table from the look poses, then a picture from one of them. Out: a
//! [`HeightMap`] of another kind: each cell is as it was (0), changed (infinitely high, as its height is
//! unknown) or not compared (NaN). Colours are compared as logarithms of their ratio, cell by cell, after a
//! smooth change of the light over the whole picture is taken out, for each of red, green and blue. What has
//! the table's own colour does not show; a shadow or a stain does. Pure.

use crate::foreign::height_map::{Area, DepthLens, HeightMap};
use cell_values::image::Image;
use nalgebra::{Isometry3, Matrix4, Point3, Vector3, Vector4};

/// A picture is compared with one from this near, m and rad: from elsewhere the gripper hides another part
/// of the table, and wood shines differently.
const SAME_PLACE: (f64, f64) = (0.005, 0.02);
/// Grey levels added to both colours: in the dark a ratio means nothing.
const DARK: f64 = 10.0;
/// A cell changed if a colour's logarithm is off by more than this, and by more than this many deviations of
/// all cells.
const CHANGED: f64 = 0.12;
const CHANGED_SIGMAS: f64 = 6.0;
/// Above this deviation of all cells nothing is said: a picture that is poor, or covered by something with a
/// pattern, would hide every change in its own scatter.
const SIGMA_MAX: f64 = 2.0 * CHANGED / CHANGED_SIGMAS;
/// Pixels without which a cell has no colour.
const PIXELS_MIN: u32 = 2;
/// Cells without which the light cannot be determined.
const CELLS_MIN: usize = 500;
/// Rounds of fitting the light and leaving out what does not follow it.
const ROUNDS: usize = 8;
/// Least deviation from the light that is left out of its fit.
const LIGHT_MIN: f64 = 0.03;

/// The empty table as the look poses see it.
#[derive(Clone, Debug, Default)]
pub struct EmptyTable {
    views: Vec<Colours>,
}

/// Mean colours of the table's cells in one picture.
#[derive(Clone, Debug)]
struct Colours {
    table_from_camera: Isometry3<f64>,
    /// Red, green, blue in grey levels; NaN where the picture does not show the cell.
    cells: Vec<[f64; 3]>,
}

impl EmptyTable {
    /// Adds a picture of the empty table. One of another size than the lens is for shows nothing.
    pub fn add(&mut self, image: &Image, lens: &DepthLens, table_from_camera: &Isometry3<f64>, area: Area) {
        self.views.push(Colours::of(image, lens, table_from_camera, area));
    }

    /// Which cells changed, as a map for [`super::find`].
    ///
    /// From a place where no picture of the empty table was taken nothing is compared.
    pub fn changed(
        &self,
        image: &Image,
        lens: &DepthLens,
        table_from_camera: &Isometry3<f64>,
        area: Area,
    ) -> HeightMap {
        let mut map = HeightMap::empty(area, table_from_camera.translation.vector.into());
        map.by_colour = true;
        let off = |view: &Colours| {
            let off = view.table_from_camera.inverse() * table_from_camera;
            (off.translation.vector.norm() / SAME_PLACE.0).max(off.rotation.angle() / SAME_PLACE.1)
        };
        let near = self.views.iter().map(|view| (off(view), view)).min_by(|a, b| a.0.total_cmp(&b.0));
        let Some((_, then)) = near.filter(|(off, _)| *off <= 1.0) else { return map };
        let now = Colours::of(image, lens, table_from_camera, area);
        let at = |cell: usize| {
            let [x, y] = map.centre(cell);
            let eye = map.eye_m;
            Point3::new((x - eye[0]) / eye[2], (y - eye[1]) / eye[2], 1.0)
        };
        let directions: Vec<Point3<f64>> = (0..map.heights_m.len()).map(at).collect();
        let by_channel: Option<Vec<_>> =
            (0..3).map(|channel| departures(then, &now, &directions, channel)).collect();
        for changed in by_channel.unwrap_or_default() {
            for (height, changed) in map.heights_m.iter_mut().zip(changed) {
                match changed {
                    Some(true) => *height = f32::INFINITY,
                    Some(false) if height.is_nan() => *height = 0.0,
                    Some(false) | None => {}
                }
            }
        }
        map
    }
}

impl Colours {
    fn of(image: &Image, lens: &DepthLens, table_from_camera: &Isometry3<f64>, area: Area) -> Colours {
        let map = HeightMap::empty(area, [0.0; 3]);
        let eye = table_from_camera.translation.vector;
        let mut sums = vec![([0.0; 3], 0u32); map.heights_m.len()];
        for ((u, v), ray) in lens.pixels() {
            let falls = table_from_camera.rotation * Vector3::new(ray[0], ray[1], 1.0);
            let Some(colour) = image.pixel(u, v).filter(|_| falls.z < -0.1) else { continue };
            let p = eye - falls * (eye.z / falls.z);
            if let Some(cell) = map.cell([p.x, p.y]) {
                let (sum, count) = &mut sums[cell];
                *count += 1;
                sum.iter_mut().zip(colour).for_each(|(sum, level)| *sum += f64::from(level));
            }
        }
        let mean = |(sum, count): ([f64; 3], u32)| match count >= PIXELS_MIN {
            true => sum.map(|sum| sum / f64::from(count)),
            false => [f64::NAN; 3],
        };
        let table_from_camera = *table_from_camera;
        Colours { table_from_camera, cells: sums.into_iter().map(mean).collect() }
    }
}

/// Which cells do not follow the change of the light; `None` for a cell that one of the pictures does not
/// show, and for all when too few are left or they scatter too much.
fn departures(
    then: &Colours,
    now: &Colours,
    directions: &[Point3<f64>],
    channel: usize,
) -> Option<Vec<Option<bool>>> {
    let ratio = |(then, now): (&[f64; 3], &[f64; 3])| {
        let ratio = ((now[channel] + DARK) / (then[channel] + DARK)).ln();
        ratio.is_finite().then_some(ratio)
    };
    let ratios: Vec<Option<f64>> = then.cells.iter().zip(&now.cells).map(ratio).collect();
    let samples: Vec<(Vector4<f64>, f64)> =
        directions.iter().zip(&ratios).filter_map(|(at, ratio)| Some((terms(at), (*ratio)?))).collect();
    let (light, sigma) = light(&samples).filter(|(_, sigma)| *sigma <= SIGMA_MAX)?;
    let limit = CHANGED.max(CHANGED_SIGMAS * sigma);
    let departs = |(at, ratio): (&Point3<f64>, &Option<f64>)| {
        ratio.map(|ratio| (ratio - light.dot(&terms(at))).abs() > limit)
    };
    Some(directions.iter().zip(&ratios).map(departs).collect())
}

/// The change of the light that most cells follow, and how closely they do.
fn light(samples: &[(Vector4<f64>, f64)]) -> Option<(Vector4<f64>, f64)> {
    if samples.len() < CELLS_MIN {
        return None;
    }
    let mut light = Vector4::new(median(samples.iter().map(|(_, ratio)| *ratio).collect()), 0.0, 0.0, 0.0);
    let mut sigma = 0.0;
    for _ in 0..ROUNDS {
        let off = |(terms, ratio): &(Vector4<f64>, f64)| (ratio - light.dot(terms)).abs();
        // Of what is normally distributed half lies within 0.67 deviations.
        sigma = 1.4826 * median(samples.iter().map(off).collect());
        let kept = LIGHT_MIN.max(3.0 * sigma);
        let (mut normal, mut right) = (Matrix4::zeros(), Vector4::zeros());
        for (terms, ratio) in samples.iter().filter(|sample| off(sample) < kept) {
            normal += terms * terms.transpose();
            right += terms * *ratio;
        }
        light = normal.cholesky()?.solve(&right);
    }
    Some((light, sigma))
}

fn terms(at: &Point3<f64>) -> Vector4<f64> {
    Vector4::new(1.0, at.x, at.y, at.x * at.x + at.y * at.y)
}

fn median(mut values: Vec<f64>) -> f64 {
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::foreign::{ForeignLimits, ForeignReport, KnownBody, find};
    use crate::testing;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rearrange::geometry::footprint::Footprint;
    use rearrange::geometry::pose::Pose2;

    const AREA: Area = Area { low: [-0.2, -0.15], high: [0.2, 0.15] };

    fn eye() -> Isometry3<f64> {
        testing::looking_down(0.0, 0.0, 0.5, [0.1, 0.0], 0.2)
    }

    /// A wooden table with flat patches (lowest and highest x and y, colour) in a light that gets `darker`
    /// from left to right.
    fn picture(patches: &[([f64; 4], [f64; 3])], gain: f64, darker: f64, seed: u64) -> Image {
        let camera = testing::camera(640, 480);
        let pixels: Vec<[f64; 2]> =
            (0..640 * 480).map(|i| [f64::from(i % 640), f64::from(i / 640)]).collect();
        let rays = crate::cv::undistort(&camera, &pixels).unwrap();
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut rgb = Vec::with_capacity(rays.len() * 3);
        for ray in rays {
            let direction = eye().rotation * Vector3::new(ray[0], ray[1], 1.0);
            let p = eye().translation.vector - direction * (eye().translation.z / direction.z);
            let grain = 12.0 * (p.y * 900.0 + (p.x * 40.0).sin()).sin();
            let mut colour = [170.0 + grain, 130.0 + grain, 90.0 + grain];
            for ([x0, y0, x1, y1], of) in patches {
                if (*x0..*x1).contains(&p.x) && (*y0..*y1).contains(&p.y) {
                    colour = *of;
                }
            }
            let light = gain * (1.0 - darker * (ray[0] + 0.5));
            for level in colour {
                let noise = 6.0 * (random.random::<f64>() + random.random::<f64>() - 1.0);
                rgb.push((level * light + noise).clamp(0.0, 255.0) as u8);
            }
        }
        Image::from_rgb(640, 480, rgb).unwrap()
    }

    fn report(now: &Image, from: &Isometry3<f64>, known: &[KnownBody]) -> ForeignReport {
        let lens = DepthLens::new(&testing::camera(640, 480)).unwrap();
        let mut empty = EmptyTable::default();
        empty.add(&picture(&[], 1.0, 0.0, 1), &lens, &eye(), AREA);
        let map = empty.changed(now, &lens, from, AREA);
        find(&[&map], known, &[], &ForeignLimits::default())
    }

    const MUG: ([f64; 4], [f64; 3]) = ([0.05, 0.02, 0.1, 0.06], [60.0, 80.0, 120.0]);

    #[test]
    fn the_same_table_in_another_light_is_unchanged() {
        for (gain, darker) in [(1.0, 0.0), (0.7, 0.0), (1.2, 0.2), (0.9, 0.3)] {
            let seen = report(&picture(&[], gain, darker, 2), &eye(), &[]);
            assert_eq!(seen.objects, [], "{gain} {darker}");
            assert!(seen.measured_share > 0.95, "{gain} {darker}: {}", seen.measured_share);
        }
    }

    #[test]
    fn a_new_colour_is_found_where_it_is_and_its_height_is_unknown() {
        for (gain, darker) in [(1.0, 0.0), (0.8, 0.3)] {
            let seen = report(&picture(&[MUG], gain, darker, 3), &eye(), &[]);
            let [object] = &seen.objects[..] else { panic!("{seen:?}") };
            assert!((object.centre[0] - 0.075).hypot(object.centre[1] - 0.04) < 0.004, "{object:?}");
            assert!(
                (object.area_m2 / 20e-4 - 1.0).abs() < 0.3 && object.height_m.is_infinite(),
                "{object:?}"
            );
            assert!(object.to_string().contains("of unknown height over"), "{object}");
        }
        let small = ([0.05, 0.02, 0.062, 0.032], MUG.1);
        assert_eq!(report(&picture(&[small], 1.0, 0.0, 3), &eye(), &[]).objects, [], "a screw");
    }

    #[test]
    fn known_objects_and_what_they_hide_and_shade_are_left_out() {
        let tile = ([-0.1, -0.05, -0.04, 0.0], [220.0, 220.0, 220.0]);
        let shadow = ([-0.04, -0.05, -0.03, 0.0], [120.0, 90.0, 60.0]);
        let known = KnownBody {
            footprint: Footprint::rectangle(0.06, 0.05).unwrap(),
            pose: Pose2::new(-0.07, -0.025, 0.0),
            height_m: 0.02,
        };
        let now = picture(&[tile, shadow, MUG], 0.9, 0.1, 4);
        assert_eq!(report(&now, &eye(), &[]).objects.len(), 2);
        let seen = report(&now, &eye(), &[known]);
        assert!(seen.objects.len() == 1 && seen.objects[0].centre[0] > 0.0, "{seen:?}");
        assert!(seen.measured_share > 0.95 && seen.largest_hole().is_none(), "{seen:?}");
    }

    #[test]
    fn a_cover_with_a_pattern_and_a_poor_picture_are_not_compared() {
        let mut random = ChaCha8Rng::seed_from_u64(6);
        let mut patches = Vec::new();
        for (column, row) in (0..26).flat_map(|column| (0..30).map(move |row| (column, row))) {
            let [x, y] = [-0.2 + 0.01 * f64::from(column), -0.15 + 0.01 * f64::from(row)];
            patches.push(([x, y, x + 0.01, y + 0.01], [random.random_range(20.0..250.0); 3]));
        }
        let seen = report(&picture(&patches, 1.0, 0.0, 6), &eye(), &[]);
        assert!(seen.measured_share == 0.0, "a patterned cloth over two thirds: {seen:?}");
        let mut dim = picture(&[MUG], 1.0, 0.0, 7);
        dim.rgb.iter_mut().for_each(|level| {
            *level = (f64::from(*level) * random.random_range(0.4..1.6)).min(255.0) as u8;
        });
        let seen = report(&dim, &eye(), &[]);
        assert!(seen.objects.len() == 1 || seen.measured_share == 0.0, "{seen:?}");
    }

    #[test]
    fn from_elsewhere_nothing_is_compared() {
        let aside = eye() * Isometry3::translation(0.01, 0.0, 0.0);
        let seen = report(&picture(&[MUG], 1.0, 0.0, 5), &aside, &[]);
        assert!(seen.objects.is_empty() && seen.measured_share == 0.0, "{seen:?}");
        assert!(seen.largest_hole().is_some_and(|hole| hole.area_m2 > 0.1), "{seen:?}");
    }
}
