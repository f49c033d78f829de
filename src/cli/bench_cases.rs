//! The cases of the planning benchmark: generated ones, or the public instances.
//!
//! In: where the cases come from. Out: ids of a cell's cases, and the problem of a case. A
//! generated case is made anew from its seed each time: a table of results needs no folder of instances
//! beside it.

use crate::bench::cells::{Cell, Unit};
use crate::cli::task::TaskArgs;
use rearrange::planning::generate::{RatioLaw, Recipe, Scenario, generate};
use rearrange::planning::problem::Problem;
use std::path::{Path, PathBuf};

/// The pairs of arrangements of discs and sticks that are taken first: those that the targets name.
const PAIRS: [&str; 3] = ["0-1", "1-3", "4-5"];

/// Where a run's cases come from.
#[derive(Clone, Debug)]
pub enum Source {
    /// The public data in a folder; these ids, or the first of each cell.
    Public {
        /// With `hetori` and `trlb` in it.
        data: PathBuf,
        /// Requested ids.
        ids: Option<Vec<String>>,
        /// How many, without ids.
        count: u64,
    },
    /// Cases of a seed.
    Generated {
        /// The seed.
        seed: u64,
        /// How many.
        count: u64,
        /// Law of the side ratios.
        ratios: RatioLaw,
    },
}

impl Source {
    /// Says what of a cell cannot be had.
    ///
    /// # Errors
    /// What is wrong with the cell.
    pub fn check(&self, cell: &Cell) -> Result<(), String> {
        let Source::Generated { ratios, .. } = self else { return Ok(()) };
        recipe(cell, *ratios)?.check().map_err(|error| error.to_string())
    }

    /// Ids of the cell's cases; of public cells those that are there.
    pub fn ids(&self, cell: &Cell) -> Vec<String> {
        match self {
            Source::Generated { seed, count, ratios } => {
                let law = if *ratios == RatioLaw::Public { "p" } else { "g" };
                (0..*count).map(|case| format!("{law}{seed}-{case}")).collect()
            }
            Source::Public { data, ids, count } => {
                let pairs = ["disk", "stick"].contains(&cell.scenario.as_str());
                let pair =
                    |k: usize| PAIRS.get(k).map_or(format!("{}-{}", 2 * k, 2 * k + 1), ToString::to_string);
                let name = |k: u64| if pairs { pair(k as usize) } else { k.to_string() };
                let ids = ids.clone().unwrap_or_else(|| (0..*count).map(name).collect());
                ids.into_iter().filter(|id| is_there(&task(data, cell, id))).collect()
            }
        }
    }

    /// Is there a public case of that id?
    pub fn has(&self, cell: &Cell, id: &str) -> bool {
        matches!(self, Source::Public { data, .. } if is_there(&task(data, cell, id)))
    }

    /// The problem of a case.
    ///
    /// # Errors
    /// Every complaint about its file, or why it cannot be generated.
    pub fn problem(&self, unit: &Unit) -> Result<Problem, String> {
        match self {
            Source::Public { data, .. } => task(data, &unit.cell, &unit.key.id).read(),
            Source::Generated { seed, ratios, .. } => {
                let case = unit.key.id.rsplit('-').next().and_then(|case| case.parse().ok());
                let case = case.ok_or_else(|| format!("{}: not the id of a case", unit.key.id))?;
                let generated = generate(&recipe(&unit.cell, *ratios)?, *seed, case)
                    .map_err(|error| format!("case {}: {error}", unit.key.id))?;
                Problem::new(&generated.instance).map_err(|faults| faults.to_string())
            }
        }
    }
}

fn recipe(cell: &Cell, ratios: RatioLaw) -> Result<Recipe, String> {
    let scenario = cell.scenario.parse::<Scenario>().map_err(|_| {
        format!("scenario {}: only rand and sq can be generated; others need --data DIR", cell.scenario)
    })?;
    Ok(Recipe { scenario, objects: cell.objects, density: cell.density, ratios })
}

fn task(data: &Path, cell: &Cell, id: &str) -> TaskArgs {
    public_task(data, &cell.scenario, cell.density, cell.objects, id)
}

fn is_there(task: &TaskArgs) -> bool {
    task.instance.is_file() && task.goal.as_ref().is_none_or(|goal| goal.is_file())
}

/// Where a case of the public data lies.
pub fn public_task(data: &Path, scenario: &str, density: f64, n: usize, id: &str) -> TaskArgs {
    let pair = |folder: &str| {
        let cell = data.join("trlb").join(folder).join(format!("D={density:.1}/n={n}"));
        let (start, goal) = id.split_once('-').unwrap_or((id, id));
        let file = |id: &str| cell.join(format!("{id}_{n}_{density:.1}.json"));
        TaskArgs { instance: file(start), goal: Some(file(goal)), shapes: None }
    };
    let folder = match scenario {
        "disk" => return pair("disks"),
        "stick" => return pair("sticks"),
        "rand" => "random_general",
        "sq" => "Klotski_blocks_2large",
        other => other,
    };
    let cell = data.join("hetori/instances").join(folder).join(format!("Density={density:.2}/numObjs={n}"));
    TaskArgs { instance: cell.join(format!("{id}_{n}_{density:.2}.json")), goal: None, shapes: None }
}
