//! A plan as a film: one drawing in which the objects go from place to place in the order of the moves.
//!
//! In: the problem and its actions, poses in m in the table frame. Out: a self-contained SVG that moves by
//! style rules alone, without a script: an arrow with the number of the move, then the object follows it;
//! again from the start after the end. It rests under the pointer, and is left out on paper and for people
//! who want no motion: the drawing of `plan_svg` beside it has all moves at once.

use crate::report::plan_svg::{
    MARGIN_PX, MARKER, PANEL_PX, Panel, TITLE_PX, colour, draw_arrow, draw_number, draw_table, draw_text,
    line, outline_points,
};
use crate::report::text::escape;
use rearrange::geometry::pose::{Pose2, wrap_angle};
use rearrange::planning::plan::Action;
use rearrange::planning::problem::Problem;
use std::fmt::Write;

/// What is said of a film.
pub const FILM_CAPTION: &str = "The moves in their order; the film rests under the pointer";

/// Seconds of one move, of which the object moves a part and its arrow is there for all.
const MOVE_S: f64 = 1.6;
/// Share of a move after which the object starts, and at which it has arrived.
const TRAVEL: (f64, f64) = (0.25, 0.85);
/// Seconds at the start and at the end in which nothing moves.
const REST_S: (f64, f64) = (1.0, 2.5);

/// The film of `actions` on `problem`; `colours` as for `coloured_plan_svg`.
pub fn plan_animation(problem: &Problem, actions: &[Action], title: &str, colours: &[usize]) -> String {
    let scale = PANEL_PX / problem.workspace.width.max(problem.workspace.height);
    let (width, height) = (problem.workspace.width * scale, problem.workspace.height * scale);
    let top = MARGIN_PX + TITLE_PX;
    let panel = Panel { left: MARGIN_PX, bottom: top + height, scale, width, height };
    let (all_width, all_height) = (width + 2.0 * MARGIN_PX, height + top + MARGIN_PX);
    let film = Film { problem, actions, panel, colours };
    let mut svg = format!(
        "<svg class=\"plan-film\" xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {all_width:.0} \
         {all_height:.0}\" width=\"{all_width:.0}\" height=\"{all_height:.0}\" \
         font-family=\"sans-serif\">\n{MARKER}"
    );
    film.style(&mut svg);
    let _ = writeln!(
        svg,
        "<rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>\n\
         <text x=\"{MARGIN_PX}\" y=\"{:.1}\" font-size=\"15\" fill=\"#222\">{}</text>",
        MARGIN_PX + 12.0,
        escape(title)
    );
    draw_table(&mut svg, &panel, problem);
    film.objects(&mut svg);
    film.arrows(&mut svg);
    svg.push_str("</svg>\n");
    svg
}

struct Film<'a> {
    problem: &'a Problem,
    actions: &'a [Action],
    panel: Panel,
    colours: &'a [usize],
}

impl Film<'_> {
    fn seconds(&self) -> f64 {
        REST_S.0 + MOVE_S * self.actions.len() as f64 + REST_S.1
    }

    /// Percent of the film at a share of the move of this index.
    fn percent(&self, index: usize, share: f64) -> f64 {
        100.0 * (REST_S.0 + MOVE_S * (index as f64 + share)) / self.seconds()
    }

    fn transform(&self, pose: &Pose2, theta: f64) -> String {
        let [x, y] = self.panel.point([pose.x, pose.y]);
        format!("transform:translate({x:.1}px,{y:.1}px) rotate({:.4}rad)", -theta)
    }

    /// Where each object is when; that a move's arrow is there while it lasts.
    fn style(&self, svg: &mut String) {
        let seconds = self.seconds();
        svg.push_str("<style>\n");
        for (index, object) in self.problem.objects.iter().enumerate() {
            let mut theta = object.start.theta;
            let start = self.transform(&object.start, theta);
            let mut frames = format!("0%{{{start}}}");
            let mut at = start.clone();
            for (number, action) in self.actions.iter().enumerate().filter(|(_, a)| a.object == index) {
                // The shorter way round, as the arm turns.
                theta += wrap_angle(action.to.theta - theta);
                let to = self.transform(&action.to, theta);
                let (from_at, to_at) = (self.percent(number, TRAVEL.0), self.percent(number, TRAVEL.1));
                let _ = write!(frames, "{from_at:.3}%{{{at}}}{to_at:.3}%{{{to}}}");
                at = to;
            }
            let _ = write!(frames, "100%{{{at}}}");
            let moves = match self.actions.iter().any(|action| action.object == index) {
                true => format!("animation:o{index} {seconds:.1}s infinite"),
                false => String::new(),
            };
            line(svg, format_args!(".plan-film .o{index}{{{start};{moves}}}"));
            if !moves.is_empty() {
                line(svg, format_args!("@keyframes o{index}{{{frames}}}"));
            }
        }
        for number in 0..self.actions.len() {
            let (from, to) = (self.percent(number, 0.0), self.percent(number, 1.0));
            line(
                svg,
                format_args!(
                    ".plan-film .s{number}{{opacity:0;animation:s{number} {seconds:.1}s step-end infinite}}\n\
                     @keyframes s{number}{{0%{{opacity:0}}{from:.3}%{{opacity:1}}{to:.3}%{{opacity:0}}\
                     100%{{opacity:0}}}}"
                ),
            );
        }
        svg.push_str(
            ".plan-film:hover *{animation-play-state:paused!important}\n\
             @media print,(prefers-reduced-motion:reduce){figure:has(.plan-film){display:none}}\n</style>\n",
        );
    }

    fn objects(&self, svg: &mut String) {
        for (index, object) in self.problem.objects.iter().enumerate() {
            let fill = colour(self.colours, index, object.fixed, 72);
            // Round the object's origin: the style rules place it.
            let here = Panel { left: 0.0, bottom: 0.0, ..self.panel };
            let points = outline_points(&here, &object.footprint, &Pose2::new(0.0, 0.0, 0.0));
            line(
                svg,
                format_args!(
                    "<g class=\"o{index}\"><polygon points=\"{points}\" fill=\"{fill}\" stroke=\"#333\"/>"
                ),
            );
            let [x, y] = here.point(object.footprint.centroid());
            draw_text(svg, [x, y + 4.0], 11.0, &object.id);
            svg.push_str("</g>\n");
        }
    }

    fn arrows(&self, svg: &mut String) {
        for (number, action) in self.actions.iter().enumerate() {
            let footprint = &self.problem.objects[action.object].footprint;
            let ring = colour(self.colours, action.object, false, 40);
            line(svg, format_args!("<g class=\"s{number}\">"));
            draw_arrow(svg, &self.panel, footprint, action);
            draw_number(svg, &self.panel, footprint, action, (number + 1, &ring));
            svg.push_str("</g>\n");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rearrange::geometry::footprint::Footprint;
    use rearrange::planning::plan::ActionKind;
    use rearrange::tabletop::instance::{Instance, ObjectSpec, Workspace};

    fn problem() -> Problem {
        let object = |id: &str, x: f64, goal: f64| ObjectSpec {
            start: Some(Pose2::new(x, 0.1, 3.0)),
            goal: Some(Pose2::new(goal, 0.1, -3.0)),
            ..ObjectSpec::new(id, Footprint::rectangle(0.06, 0.04).expect("a rectangle"))
        };
        let objects = vec![object("a", 0.1, 0.3), object("b <i>", 0.2, 0.2)];
        let workspace = Workspace { width: 0.4, height: 0.2 };
        let instance =
            Instance { workspace, clearance: 0.0, overlap_tolerance: 0.0, keep_out: Vec::new(), objects };
        Problem::new(&instance).expect("sound")
    }

    #[test]
    fn what_moves_moves_the_shorter_way_and_what_stays_stays() {
        let problem = problem();
        let to = Pose2::new(0.3, 0.1, -3.0);
        let action = Action { object: 0, from: problem.objects[0].start, to, kind: ActionKind::Goal };
        let film = plan_animation(&problem, &[action], "t", &[]);
        assert!(
            film.contains("@keyframes o0{0%{transform:translate(164.0px,192.0px) rotate(-3.0000rad)}"),
            "{film}"
        );
        // 3 rad to -3 rad is 0.28 rad further, not 6 rad back.
        assert!(film.contains("100%{transform:translate(444.0px,192.0px) rotate(-3.2832rad)}"), "{film}");
        assert!(!film.contains("@keyframes o1"), "{film}");
        assert!(film.contains(">b &lt;i&gt;</text>") && !film.contains("<script"), "{film}");
        assert_eq!(film.matches("class=\"s").count(), 1);
    }

    #[test]
    fn a_plan_without_moves_has_no_motion() {
        let film = plan_animation(&problem(), &[], "t", &[]);
        assert!(!film.contains("@keyframes"), "{film}");
    }
}
