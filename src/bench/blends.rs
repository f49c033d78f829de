//! `bench motion`: the cost of corners that are safe at any blend speed.
//!
//! In: limits of the arm, jobs of each scene. Out: mean seconds of a pick-n-place with the simulated arm
//! passing blends at each speed that it can play, and without any limit in corners.

use crate::bench::cycle::{FAST, Pace, USUAL, means, measure_pace};
use cell_motion::path::BlendSpeed;
use ur_sim::motion::rounding::{ENTRY_SPEEDS, EntrySpeed};

/// Cycle times with one blend speed.
#[derive(Clone, Debug, serde::Serialize)]
pub struct BlendFigures {
    /// For the table.
    pub name: String,
    /// Mean seconds of a pick-n-place at the usual limits, and at the fast ones without the heavy scene.
    pub cycle_s: [f64; 2],
    /// Failed jobs and broken rules.
    pub faults: Vec<String>,
}

/// One row for each blend speed. The last row is an arm that brakes and a celld that relies on it.
pub fn measure_blends(jobs: u64, progress: &dyn Fn(&str)) -> Vec<BlendFigures> {
    let safe = ENTRY_SPEEDS.iter().map(|(name, speed)| (name.to_string(), *speed, BlendSpeed::Unknown));
    let braked = ("braked, relied on".to_string(), EntrySpeed::Braked, BlendSpeed::Braked);
    safe.chain([braked])
        .map(|(name, entry_speed, blend_speed)| {
            let scenes =
                [USUAL, FAST].map(|pace| measure_pace(&Pace { entry_speed, blend_speed, ..pace }, jobs));
            progress(&format!("{jobs} jobs of each scene at each of two limits, blends {name}"));
            let [usual, fast] = &scenes;
            let cycle_s = [means(usual, false).cycle_s, means(fast, true).cycle_s];
            let faults = scenes.iter().flatten().flat_map(|scene| scene.faults.clone()).collect();
            BlendFigures { name, cycle_s, faults }
        })
        .collect()
}

/// The figures for people.
pub fn table(figures: &[BlendFigures]) -> String {
    let mut text = format!("{:<20}{:>8}{:>22}\n", "blends are passed", "usual", "fast, without desk");
    for row in figures {
        let [usual, fast] = row.cycle_s;
        text.push_str(&format!("{:<20}{usual:>8.2}{fast:>22.2}\n", row.name));
        row.faults.iter().for_each(|fault| text.push_str(&format!("  {fault}\n")));
    }
    if let (Some(safe), Some(relied)) = (figures.first(), figures.last()) {
        let [usual, fast] = [0, 1].map(|limits| safe.cycle_s[limits] - relied.cycle_s[limits]);
        text.push_str(&format!("{:<20}{usual:>8.2}{fast:>22.2}\n", "safe corners cost, s"));
    }
    text
}
