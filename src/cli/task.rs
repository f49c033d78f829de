//! Reads the task that `plan` and `verify` work on: instance, separate goal, shape files.
//!
//! In: paths from the command line. Out: a [`Problem`], or the text of everything that is wrong with the
//! files, each complaint with its place. Shape names come out of a file, so only plain names are looked up.

use cell_edge::terminal::read_text;
use rearrange::planning::problem::Problem;
use rearrange::tabletop::instance::Instance;
use rearrange::tabletop::parse::{parse_instance, parse_pair};
use std::path::{Path, PathBuf};

/// Where a task is.
#[derive(Clone, Debug, clap::Args)]
pub struct TaskArgs {
    /// Instance file (YAML or JSON), or the start arrangement of a disc or stick problem
    pub instance: PathBuf,
    /// Goal arrangement, if it is in a file of its own
    #[arg(long, value_name = "FILE")]
    pub goal: Option<PathBuf>,
    /// Folder of the shapes an instance names; default: `shapes` beside the folder `instances`
    #[arg(long, value_name = "DIR")]
    pub shapes: Option<PathBuf>,
}

impl TaskArgs {
    /// Reads and checks the task.
    ///
    /// # Errors
    /// The text to show: one line for each complaint.
    pub fn read(&self) -> Result<Problem, String> {
        let instance = self.read_instance()?;
        Problem::new(&instance).map_err(|faults| prefixed(&self.instance, &faults.to_string()))
    }

    /// Reads the instance alone; what only a problem can find wrong is not looked for.
    ///
    /// # Errors
    /// The text to show: one line for each complaint.
    pub fn read_instance(&self) -> Result<Instance, String> {
        let folder = self.shapes.clone().or_else(|| shapes_beside(&self.instance));
        let shapes = |name: &str| shape_text(folder.as_deref()?, name);
        let source = self.instance.display().to_string();
        let parsed = match (read_text(&self.instance), self.goal.as_ref().map(|goal| (goal, read_text(goal))))
        {
            (text, None) => parse_instance(&text?, &source, &shapes),
            (Ok(text), Some((goal, Ok(goal_text)))) => {
                parse_pair((&text, &source), (&goal_text, &goal.display().to_string()), &shapes)
            }
            (first, Some((_, second))) => {
                let faults: Vec<String> = [first.err(), second.err()].into_iter().flatten().collect();
                return Err(faults.join("\n"));
            }
        };
        parsed.map_err(|complaints| complaints.to_string())
    }
}

fn prefixed(path: &Path, lines: &str) -> String {
    lines.lines().map(|line| format!("{}: {line}", path.display())).collect::<Vec<_>>().join("\n")
}

/// `.../shapes` for an instance somewhere below `.../instances`.
fn shapes_beside(instance: &Path) -> Option<PathBuf> {
    let absolute = std::path::absolute(instance).ok()?;
    let instances =
        absolute.ancestors().find(|folder| folder.file_name().is_some_and(|n| n == "instances"))?;
    Some(instances.parent()?.join("shapes")).filter(|folder| folder.is_dir())
}

fn shape_text(folder: &Path, name: &str) -> Option<String> {
    let plain = !name.is_empty() && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_' || c == '-');
    if !plain {
        return None;
    }
    read_text(&folder.join(format!("{name}.json"))).ok()
}

/// A line of results on standard output, as `println!`, without the panic when the reader has gone away.
macro_rules! outln {
    ($($arguments:tt)*) => {
        cell_edge::terminal::print(&format!("{}\n", format_args!($($arguments)*)))
    };
}
pub(crate) use outln;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shape_names_cannot_leave_the_folder() {
        let folder = tempfile::tempdir().unwrap();
        let shapes = folder.path().join("shapes");
        std::fs::create_dir_all(&shapes).unwrap();
        std::fs::write(folder.path().join("secret.json"), "{}").unwrap();
        std::fs::write(shapes.join("mug.json"), "[]").unwrap();
        assert_eq!(shape_text(&shapes, "mug").as_deref(), Some("[]"));
        assert_eq!(shape_text(&shapes, "../secret"), None);
        assert_eq!(shape_text(&shapes, ""), None);
    }

    #[test]
    fn shapes_are_found_beside_the_instances() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir_all(folder.path().join("shapes")).unwrap();
        let cell = folder.path().join("instances/Tetris0/numObjs=8");
        std::fs::create_dir_all(&cell).unwrap();
        assert_eq!(shapes_beside(&cell.join("0.json")), Some(folder.path().join("shapes")));
    }
}
