//! A plan as one picture: the table before, and the table after with every move as a numbered arrow.
//!
//! In: the problem and its actions, poses in m in the table frame. Out: the text of a self-contained SVG; x
//! to the right, y up as on the table. Left: the start arrangement with the objects' names. Right: where
//! every object ends, where it was (pale), where it waited on the way (dashed), and the order of the moves.

use crate::report::colour;
use crate::report::text::escape;
use rearrange::geometry::footprint::Footprint;
use rearrange::geometry::pose::Pose2;
use rearrange::planning::plan::{Action, ActionKind};
use rearrange::planning::problem::Problem;
use std::fmt::Write;

/// Longer side of one panel, pixels.
pub(super) const PANEL_PX: f64 = 560.0;

/// Space around the panels, pixels.
pub(super) const MARGIN_PX: f64 = 24.0;

/// Height of the line of text above the panels, pixels.
pub(super) const TITLE_PX: f64 = 28.0;

/// Corners that represent a curve.
const CURVE_CORNERS: usize = 64;

/// The picture of `actions` on `problem`, with `title` above it.
pub fn plan_svg(problem: &Problem, actions: &[Action], title: &str) -> String {
    coloured_plan_svg(problem, actions, title, &[])
}

/// The same where the objects' colours are those of other places than in the problem: of a catalogue that
/// has more of them.
pub fn coloured_plan_svg(problem: &Problem, actions: &[Action], title: &str, colours: &[usize]) -> String {
    let scale = PANEL_PX / problem.workspace.width.max(problem.workspace.height);
    let (width, height) = (problem.workspace.width * scale, problem.workspace.height * scale);
    let top = MARGIN_PX + TITLE_PX;
    let left = Panel { left: MARGIN_PX, bottom: top + height, scale, width, height };
    let right = Panel { left: 2.0 * MARGIN_PX + width, ..left };
    let (all_width, all_height) = (2.0 * width + 3.0 * MARGIN_PX, height + top + MARGIN_PX);
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {all_width:.0} {all_height:.0}\" \
         width=\"{all_width:.0}\" height=\"{all_height:.0}\" font-family=\"sans-serif\">\n{MARKER}\
         <rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>\n\
         <text x=\"{MARGIN_PX}\" y=\"{:.1}\" font-size=\"15\" fill=\"#222\">{}</text>\n",
        MARGIN_PX + 12.0,
        escape(title)
    );
    draw_table(&mut svg, &left, problem);
    draw_start(&mut svg, &left, problem, colours);
    draw_table(&mut svg, &right, problem);
    draw_moves(&mut svg, &right, problem, actions, colours);
    svg.push_str("</svg>\n");
    svg
}

/// The tip of an arrow.
pub(super) const MARKER: &str = "<defs><marker id=\"tip\" viewBox=\"0 0 8 8\" refX=\"7\" refY=\"4\" markerWidth=\"7\" \
     markerHeight=\"7\" orient=\"auto\"><path d=\"M0 0 L8 4 L0 8 z\" fill=\"#222\"/></marker></defs>\n";

/// One picture of the table: table frame to pixels.
#[derive(Clone, Copy)]
pub(super) struct Panel {
    pub left: f64,
    pub bottom: f64,
    pub scale: f64,
    pub width: f64,
    pub height: f64,
}

impl Panel {
    pub fn point(&self, p: [f64; 2]) -> [f64; 2] {
        [self.left + p[0] * self.scale, self.bottom - p[1] * self.scale]
    }
}

/// Writing to a string cannot fail.
pub(super) fn line(svg: &mut String, text: std::fmt::Arguments) {
    let _ = svg.write_fmt(text);
    svg.push('\n');
}

pub(super) fn draw_table(svg: &mut String, panel: &Panel, problem: &Problem) {
    line(
        svg,
        format_args!(
            "<rect x=\"{:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{:.1}\" fill=\"#f6f4ef\" \
             stroke=\"#555\"/>",
            panel.left,
            panel.bottom - panel.height,
            panel.width,
            panel.height
        ),
    );
    for region in &problem.keep_out {
        draw_footprint(svg, panel, &region.footprint, &region.pose, "fill=\"#d9d4c8\" stroke=\"#999\"");
    }
}

fn draw_start(svg: &mut String, panel: &Panel, problem: &Problem, colours: &[usize]) {
    for (index, object) in problem.objects.iter().enumerate() {
        let style = format!("fill=\"{}\" stroke=\"#333\"", colour(colours, index, object.fixed, 72));
        draw_footprint(svg, panel, &object.footprint, &object.start, &style);
    }
    for object in &problem.objects {
        let [x, y] = panel.point(label_point(&object.footprint, &object.start));
        draw_text(svg, [x, y + 4.0], 11.0, &object.id);
    }
}

fn draw_moves(svg: &mut String, panel: &Panel, problem: &Problem, actions: &[Action], colours: &[usize]) {
    let mut ends: Vec<Pose2> = problem.objects.iter().map(|object| object.start).collect();
    for action in actions {
        ends[action.object] = action.to;
    }
    for (index, object) in problem.objects.iter().enumerate() {
        if object.start != ends[index] {
            let style =
                format!("fill=\"none\" stroke=\"{}\" stroke-width=\"1\"", colour(colours, index, false, 80));
            draw_footprint(svg, panel, &object.footprint, &object.start, &style);
        }
    }
    for (index, object) in problem.objects.iter().enumerate() {
        let style = format!("fill=\"{}\" stroke=\"#333\"", colour(colours, index, object.fixed, 72));
        draw_footprint(svg, panel, &object.footprint, &ends[index], &style);
    }
    for action in actions.iter().filter(|a| a.kind == ActionKind::Buffer && a.to != ends[a.object]) {
        let style = format!(
            "fill=\"none\" stroke=\"{}\" stroke-width=\"2\" stroke-dasharray=\"5 3\"",
            colour(colours, action.object, false, 40)
        );
        draw_footprint(svg, panel, &problem.objects[action.object].footprint, &action.to, &style);
    }
    for action in actions {
        draw_arrow(svg, panel, &problem.objects[action.object].footprint, action);
    }
    for (number, action) in actions.iter().enumerate() {
        let ring = colour(colours, action.object, false, 40);
        draw_number(svg, panel, &problem.objects[action.object].footprint, action, (number + 1, &ring));
    }
}

pub(super) fn draw_arrow(svg: &mut String, panel: &Panel, footprint: &Footprint, action: &Action) {
    let from = panel.point(label_point(footprint, &action.from));
    let to = panel.point(label_point(footprint, &action.to));
    line(
        svg,
        format_args!(
            "<line x1=\"{:.1}\" y1=\"{:.1}\" x2=\"{:.1}\" y2=\"{:.1}\" stroke=\"#222\" stroke-width=\"1.2\" \
             marker-end=\"url(#tip)\"/>",
            from[0], from[1], to[0], to[1]
        ),
    );
}

/// The number sits at a third of the way: two arrows that cross in the middle stay readable.
pub(super) fn draw_number(
    svg: &mut String,
    panel: &Panel,
    footprint: &Footprint,
    action: &Action,
    (number, ring): (usize, &str),
) {
    let from = panel.point(label_point(footprint, &action.from));
    let to = panel.point(label_point(footprint, &action.to));
    let at = [from[0] + (to[0] - from[0]) / 3.0, from[1] + (to[1] - from[1]) / 3.0];
    line(
        svg,
        format_args!(
            "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"8.5\" fill=\"#fff\" stroke=\"{}\" stroke-width=\"2\"/>",
            at[0], at[1], ring
        ),
    );
    draw_text(svg, [at[0], at[1] + 3.7], 10.5, &number.to_string());
}

pub(super) fn draw_text(svg: &mut String, at: [f64; 2], size: f64, text: &str) {
    line(
        svg,
        format_args!(
            "<text x=\"{:.1}\" y=\"{:.1}\" font-size=\"{size}\" text-anchor=\"middle\" \
             fill=\"#111\">{}</text>",
            at[0],
            at[1],
            escape(text)
        ),
    );
}

fn draw_footprint(svg: &mut String, panel: &Panel, footprint: &Footprint, pose: &Pose2, style: &str) {
    let points = outline_points(panel, footprint, pose);
    line(svg, format_args!("<polygon points=\"{points}\" {style}/>"));
}

/// The corners of a footprint, as a polygon has them.
pub(super) fn outline_points(panel: &Panel, footprint: &Footprint, pose: &Pose2) -> String {
    let corners = footprint.outline(CURVE_CORNERS).into_iter().map(|corner| {
        let [x, y] = panel.point(pose.transform(corner));
        format!("{x:.1},{y:.1}")
    });
    corners.collect::<Vec<_>>().join(" ")
}

/// Where a name or an arrow belongs: the centroid, which for a polygon need not be the origin.
fn label_point(footprint: &Footprint, pose: &Pose2) -> [f64; 2] {
    pose.transform(footprint.centroid())
}

/// The hue of an object at a lightness; what never moves is grey.
pub(super) fn colour(colours: &[usize], index: usize, fixed: bool, lightness: u32) -> String {
    match fixed {
        true => colour::FIXED.to_string(),
        false => colour::shade(colours.get(index).copied().unwrap_or(index), lightness),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rearrange::tabletop::instance::{Instance, ObjectSpec, Workspace};

    fn problem() -> Problem {
        let mut object = ObjectSpec::new("a<b", Footprint::rectangle(0.2, 0.1).unwrap());
        object.start = Some(Pose2::new(0.2, 0.2, 0.0));
        object.goal = Some(Pose2::new(0.8, 0.4, 0.0));
        Problem::new(&Instance {
            workspace: Workspace { width: 1.0, height: 0.5 },
            clearance: 0.0,
            overlap_tolerance: 0.0,
            keep_out: Vec::new(),
            objects: vec![object],
        })
        .unwrap()
    }

    #[test]
    fn every_move_has_its_number_and_names_are_escape() {
        let problem = problem();
        let (start, goal) = (problem.objects[0].start, Pose2::new(0.8, 0.4, 0.0));
        let buffer = Pose2::new(0.5, 0.25, 1.0);
        let actions = [
            Action { object: 0, from: start, to: buffer, kind: ActionKind::Buffer },
            Action { object: 0, from: buffer, to: goal, kind: ActionKind::Goal },
        ];
        let svg = plan_svg(&problem, &actions, "2 moves & more");
        assert_eq!(svg.matches("marker-end").count(), 2);
        assert!(svg.contains(">1</text>") && svg.contains(">2</text>"));
        assert!(svg.contains("a&lt;b") && !svg.contains("a<b"));
        assert!(svg.contains("2 moves &amp; more"));
        assert_eq!(svg.matches("stroke-dasharray").count(), 1);
    }

    #[test]
    fn y_points_up() {
        let svg = plan_svg(&problem(), &[], "");
        // Start at y = 0.2 of 0.5 m: the rectangle's top edge, y = 0.25, is half way up the panel.
        let middle = MARGIN_PX + TITLE_PX + 0.5 * 0.5 * PANEL_PX;
        assert!(svg.contains(&format!(",{middle:.1}")), "{svg}");
    }
}
