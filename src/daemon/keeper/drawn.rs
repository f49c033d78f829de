//! Plans and pictures in the folders of jobs, for whoever approves or looks later.
//!
//! In: the active job's plan, the camera's last picture. Out: `plan.json`, `plan.svg`, `plan.jpg` with the
//! numbered moves, `end.jpg`. They are copies: a disk that does not take them keeps nothing back.

use super::StateKeeper;
use crate::daemon::plan_files;
use cell_edge::files::write_whole;
use rearrange::document::chain::chain;
use std::path::Path;

impl StateKeeper {
    /// Puts what is planned into the active job's folder; a disk that does not take it keeps nothing back.
    pub(super) fn draw_plan(&mut self) {
        if !std::mem::take(&mut self.undrawn) {
            return;
        }
        let (Some((id, _)), Some(plan)) = (&self.active, &self.plan) else { return };
        let Ok(Some(folder)) = self.spool.folder_now(&self.journal, id) else { return };
        if let Err(error) = plan_files::write(&folder, id, plan, &self.config) {
            tracing::warn!(id, error = %chain(&error), "the plan could not be written into the job's folder");
        }
        let moves = plan_files::drawn_moves(plan, &self.config);
        let jpeg = match plan.preview {
            true => self.pictures.of_any(&moves),
            false => self.pictures.of_job(&moves),
        };
        self.leave_picture(jpeg, &folder.join("plan.jpg"));
    }

    /// A picture is no reason to hold anything up.
    pub(super) fn leave_picture(&self, jpeg: Option<Vec<u8>>, path: &Path) {
        let Some(jpeg) = jpeg.filter(|_| self.disk.takes_pictures()) else { return };
        if let Err(error) = write_whole(path, &jpeg) {
            tracing::warn!(error = %chain(&error), "a picture could not be written into the job's folder");
        }
    }
}
