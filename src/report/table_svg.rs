//! A drawing of the table from above: where objects began, should be, and are.
//!
//! In: workspace, footprints and poses in the table frame (m). Out: one SVG element of fixed style that
//! reads in light and in dark. y points up as in the table frame; the robot is below the lower edge.

use crate::report::colour;
use crate::report::text::escape;
use rearrange::geometry::footprint::Footprint;
use rearrange::geometry::pose::Pose2;
use std::fmt::Write as _;

/// Pixels along the longer edge of the table.
const SCALE_PX: f64 = 560.0;

/// Pixels around the table.
const MARGIN_PX: f64 = 26.0;

/// Corners for curved outlines.
const CORNERS: usize = 72;

/// What is drawn.
#[derive(Clone, Debug)]
pub struct TableDrawing<'a> {
    /// Names the drawing for screen readers.
    pub title: &'a str,
    /// Table extent along x, m.
    pub width_m: f64,
    /// Table extent along y, m.
    pub height_m: f64,
    /// Places that stay free.
    pub keep_out: Vec<(&'a Footprint, Pose2)>,
    /// Objects in an order that gives each its colour.
    pub objects: Vec<DrawnObject<'a>>,
}

/// One object and the poses of it that are known.
#[derive(Clone, Copy, Debug)]
pub struct DrawnObject<'a> {
    /// Label.
    pub id: &'a str,
    /// Shape.
    pub footprint: &'a Footprint,
    /// Dotted.
    pub start: Option<Pose2>,
    /// Dashed.
    pub goal: Option<Pose2>,
    /// Filled.
    pub measured: Option<Pose2>,
}

/// Draws the table; objects are filled where they are measured, or at their start if they are not.
pub fn table_svg(drawing: &TableDrawing) -> String {
    let scale = SCALE_PX / drawing.width_m.max(drawing.height_m).max(1e-6);
    let view = View { scale, height_m: drawing.height_m };
    let (width, height) = (drawing.width_m * scale, drawing.height_m * scale);
    let mut svg = String::new();
    let _ = write!(
        svg,
        r#"<svg xmlns="http://www.w3.org/2000/svg" class="table" viewBox="{:.0} {:.0} {:.0} {:.0}" role="img" aria-label="{}"><style>{STYLE}</style>"#,
        -MARGIN_PX,
        -MARGIN_PX,
        width + 2.0 * MARGIN_PX,
        height + 2.0 * MARGIN_PX,
        escape(drawing.title)
    );
    let _ = write!(svg, r#"<rect class="t-top" width="{width:.1}" height="{height:.1}" rx="3"/>"#);
    grid(&mut svg, drawing, &view);
    for (footprint, pose) in &drawing.keep_out {
        let _ = write!(svg, r#"<path class="t-keep" d="{}"/>"#, view.outline(footprint, pose));
    }
    for (index, object) in drawing.objects.iter().enumerate() {
        draw_object(&mut svg, &view, index, object);
    }
    legend(&mut svg, drawing, width, height);
    svg.push_str("</svg>");
    svg
}

const STYLE: &str = ".t-top{fill:#f6f4ef;stroke:#8a867c}.t-grid{stroke:#8a867c;stroke-opacity:.18}\
.t-keep{fill:#8a867c;fill-opacity:.25}.t-is{fill-opacity:.55;stroke-width:1.5}\
.t-start{fill:none;stroke-width:1.2;stroke-dasharray:1.5 3;stroke-linecap:round;opacity:.8}\
.t-goal{fill:none;stroke-width:1.8;stroke-dasharray:7 4}\
.t-id{font:600 12px system-ui,sans-serif;fill:#1d1c1a;text-anchor:middle;dominant-baseline:central}\
.t-note{font:11px system-ui,sans-serif;fill:#6d6a62}\
@media(prefers-color-scheme:dark){.t-top{fill:#24262a;stroke:#777c85}.t-grid{stroke:#aab}.t-id{fill:#f2f1ee}\
.t-note{fill:#a9adb5}}";

/// Table frame to pixels: y is turned over.
struct View {
    scale: f64,
    height_m: f64,
}

impl View {
    fn point(&self, p: [f64; 2]) -> (f64, f64) {
        (p[0] * self.scale, (self.height_m - p[1]) * self.scale)
    }

    fn outline(&self, footprint: &Footprint, pose: &Pose2) -> String {
        let mut path = String::new();
        for (index, corner) in footprint.outline(CORNERS).iter().enumerate() {
            let (x, y) = self.point(pose.transform(*corner));
            let _ = write!(path, "{}{x:.1} {y:.1}", if index == 0 { 'M' } else { 'L' });
        }
        path.push('Z');
        path
    }
}

/// Lines every 0.1 m.
fn grid(svg: &mut String, drawing: &TableDrawing, view: &View) {
    let (left, bottom) = view.point([0.0, 0.0]);
    let (right, top) = view.point([drawing.width_m, drawing.height_m]);
    let lines = |extent: f64| (1..100).map(|k| f64::from(k) * 0.1).take_while(move |v| *v < extent - 1e-9);
    for x in lines(drawing.width_m) {
        let x = view.point([x, 0.0]).0;
        let _ = write!(svg, r#"<path class="t-grid" d="M{x:.1} {top:.1}V{bottom:.1}"/>"#);
    }
    for y in lines(drawing.height_m) {
        let y = view.point([0.0, y]).1;
        let _ = write!(svg, r#"<path class="t-grid" d="M{left:.1} {y:.1}H{right:.1}"/>"#);
    }
}

fn draw_object(svg: &mut String, view: &View, index: usize, object: &DrawnObject) {
    let colour = colour::of(index);
    if let Some(pose) = &object.start {
        let path = view.outline(object.footprint, pose);
        let _ = write!(svg, r#"<path class="t-start" stroke="{colour}" d="{path}"/>"#);
    }
    let Some(at) = object.measured.or(object.start).or(object.goal) else { return };
    if object.measured.is_some() || object.goal.is_none() {
        let path = view.outline(object.footprint, &at);
        let _ = write!(
            svg,
            r#"<path class="t-is" fill="{colour}" stroke="{colour}" d="{path}"><title>{}</title></path>"#,
            escape(object.id)
        );
    }
    if let Some(pose) = &object.goal {
        let path = view.outline(object.footprint, pose);
        let _ = write!(svg, r#"<path class="t-goal" stroke="{colour}" d="{path}"/>"#);
    }
    let label = object.measured.or(object.goal).unwrap_or(at);
    let (x, y) = view.point(label.transform(object.footprint.centroid()));
    let _ = write!(svg, r#"<text class="t-id" x="{x:.1}" y="{y:.1}">{}</text>"#, escape(object.id));
}

fn legend(svg: &mut String, drawing: &TableDrawing, width: f64, height: f64) {
    let any = |test: fn(&DrawnObject) -> bool| drawing.objects.iter().any(test);
    let kinds = [
        (any(|object| object.start.is_some()), "dotted: start"),
        (any(|object| object.goal.is_some()), "dashed: goal"),
        (any(|object| object.measured.is_some()), "filled: measured"),
    ];
    let text: Vec<_> = kinds.iter().filter(|(present, _)| *present).map(|(_, text)| *text).collect();
    let y = height + 17.0;
    let _ = write!(svg, r#"<text class="t-note" x="0" y="{y:.0}">{}</text>"#, text.join("   "));
    let size = format!("{:.2} m x {:.2} m, grid 0.1 m", drawing.width_m, drawing.height_m);
    let _ = write!(svg, r#"<text class="t-note" x="{width:.0}" y="{y:.0}" text-anchor="end">{size}</text>"#);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn draw(goal: Option<Pose2>, measured: Option<Pose2>) -> String {
        let footprint = Footprint::rectangle(0.1, 0.05).unwrap();
        let start = Some(Pose2::new(0.1, 0.1, 0.0));
        table_svg(&TableDrawing {
            title: "a <table>",
            width_m: 0.5,
            height_m: 0.4,
            keep_out: Vec::new(),
            objects: vec![DrawnObject { id: "a&b", footprint: &footprint, start, goal, measured }],
        })
    }

    #[test]
    fn y_points_up_and_text_is_escaped() {
        let svg = draw(None, None);
        // The lower left corner (0.05, 0.075) m at 1120 px/m, from the top of a 0.4 m table.
        assert!(svg.contains("56.0 364.0"), "{svg}");
        assert!(svg.contains("a&amp;b") && svg.contains("a &lt;table&gt;") && !svg.contains("a&b"));
    }

    #[test]
    fn each_known_pose_is_drawn_in_its_style() {
        let count = |svg: &str, class: &str| svg.matches(&format!(r#"class="{class}""#)).count();
        let pose = Some(Pose2::new(0.3, 0.2, 0.5));
        for (goal, measured, expected) in
            [(None, None, (1, 0, 1)), (pose, None, (1, 1, 0)), (pose, pose, (1, 1, 1))]
        {
            let svg = draw(goal, measured);
            let found = (count(&svg, "t-start"), count(&svg, "t-goal"), count(&svg, "t-is"));
            assert_eq!(found, expected, "{goal:?} {measured:?}");
        }
    }
}
