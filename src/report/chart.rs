//! A figure of line charts side by side: the layout of the paper's evaluation figures.
//!
//! In: a [`Figure`] of panels that share their x axis, each with curves of points. Out: one SVG on white.
//! Every curve keeps its colour, mark and dash in all panels and in the legend; neighbours are moved apart
//! by a few pixels so that equal values stay visible. Whiskers are drawn where a point has a spread. Text is
//! text: it needs a sans-serif font where the SVG is shown ([`crate::report::raster`] brings its own).

use crate::report::text::escape;
use std::fmt::Write as _;

/// A figure.
#[derive(Clone, Debug)]
pub struct Figure {
    /// First line.
    pub title: String,
    /// Second line, smaller.
    pub subtitle: String,
    /// Under each x axis.
    pub x_label: String,
    /// Places on the x axis that have data, and their labels; ascending.
    pub x_ticks: Vec<(f64, String)>,
    /// From left to right; curves without marks come last in each.
    pub panels: Vec<Panel>,
}

/// One chart of a figure.
#[derive(Clone, Debug)]
pub struct Panel {
    /// Above it.
    pub title: String,
    /// How y is drawn.
    pub scale: Scale,
    /// What is drawn.
    pub curves: Vec<Curve>,
}

/// How a panel's y axis runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scale {
    /// Round numbers about the data.
    Linear,
    /// Powers of ten about the data.
    Log,
    /// 0 to 100 %, values as fractions.
    Percent,
}

/// One curve.
#[derive(Clone, Debug)]
pub struct Curve {
    /// In the legend.
    pub name: String,
    /// How it looks.
    pub look: Look,
    /// By ascending x.
    pub points: Vec<Point>,
}

/// A value and how sure it is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// On the x axis.
    pub x: f64,
    /// Value.
    pub y: f64,
    /// Half the length of the whisker; 0 draws none.
    pub spread: f64,
}

/// Colour, mark and dash of a curve.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Look {
    /// CSS colour.
    pub colour: &'static str,
    /// Mark at each point.
    pub mark: Mark,
    /// Solid line and filled mark, or dashed and hollow.
    pub solid: bool,
}

/// Shape of a mark.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mark {
    /// None: a line without marks across the panel's points.
    None,
    /// Disc.
    Disc,
    /// Square.
    Square,
    /// Triangle.
    Triangle,
    /// Diamond.
    Diamond,
}

const PANEL_WIDTH: f64 = 300.0;
const PANEL_HEIGHT: f64 = 230.0;
const GAP: f64 = 74.0;
const LEFT: f64 = 66.0;
const TOP: f64 = 92.0;
const BELOW: f64 = 92.0;
const RIGHT: f64 = 24.0;
/// Distance of neighbouring curves at the same x.
const DODGE: f64 = 6.0;
const INK: &str = "#222";

/// Draws the figure.
pub fn figure_svg(figure: &Figure) -> String {
    let count = figure.panels.len().max(1) as f64;
    let width = LEFT + count * PANEL_WIDTH + (count - 1.0) * GAP + RIGHT;
    let height = TOP + PANEL_HEIGHT + BELOW;
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width:.0}\" height=\"{height:.0}\" \
         viewBox=\"0 0 {width:.0} {height:.0}\" font-family=\"sans-serif\" role=\"img\" aria-label=\"{}\">\n\
         <rect width=\"{width:.0}\" height=\"{height:.0}\" fill=\"#fff\"/>\n",
        escape(&figure.title)
    );
    text(&mut svg, [LEFT, 28.0], (17.0, "start"), &figure.title);
    text(&mut svg, [LEFT, 48.0], (12.5, "start"), &figure.subtitle);
    for (index, panel) in figure.panels.iter().enumerate() {
        let left = LEFT + index as f64 * (PANEL_WIDTH + GAP);
        draw_panel(&mut svg, figure, panel, left);
    }
    legend(&mut svg, figure, height - 18.0);
    svg.push_str("</svg>\n");
    svg
}

/// From values to pixels.
struct Axes {
    left: f64,
    x: [f64; 2],
    y: [f64; 2],
    log: bool,
}

impl Axes {
    fn px(&self, x: f64) -> f64 {
        self.left + PANEL_WIDTH * (x - self.x[0]) / (self.x[1] - self.x[0])
    }

    fn py(&self, y: f64) -> f64 {
        let on_axis = |v: f64| if self.log { v.max(1e-12).log10() } else { v };
        let [low, high] = self.y.map(on_axis);
        let share = ((on_axis(y) - low) / (high - low)).clamp(0.0, 1.0);
        TOP + PANEL_HEIGHT * (1.0 - share)
    }
}

fn draw_panel(svg: &mut String, figure: &Figure, panel: &Panel, left: f64) {
    let ticks = y_ticks(panel);
    let (first, last) = (ticks.first().map_or(0.0, |t| t.0), ticks.last().map_or(1.0, |t| t.0));
    let axes = Axes { left, x: x_range(&figure.x_ticks), y: [first, last], log: panel.scale == Scale::Log };
    text(svg, [left + PANEL_WIDTH / 2.0, TOP - 16.0], (14.0, "middle"), &panel.title);
    for (value, label) in &ticks {
        let y = axes.py(*value);
        line(svg, [left, y, left + PANEL_WIDTH, y], "#e2e2e2", 1.0);
        text(svg, [left - 8.0, y + 4.5], (13.0, "end"), label);
    }
    for (value, label) in &figure.x_ticks {
        let x = axes.px(*value);
        line(svg, [x, TOP + PANEL_HEIGHT, x, TOP + PANEL_HEIGHT + 5.0], INK, 1.0);
        text(svg, [x, TOP + PANEL_HEIGHT + 20.0], (13.0, "middle"), label);
    }
    let below = TOP + PANEL_HEIGHT + 42.0;
    text(svg, [left + PANEL_WIDTH / 2.0, below], (13.0, "middle"), &figure.x_label);
    let _ = writeln!(
        svg,
        "<rect x=\"{left:.1}\" y=\"{TOP:.1}\" width=\"{PANEL_WIDTH:.1}\" height=\"{PANEL_HEIGHT:.1}\" \
         fill=\"none\" stroke=\"{INK}\"/>"
    );
    let marked = panel.curves.iter().filter(|curve| curve.look.mark != Mark::None).count();
    let middle = (marked.max(1) - 1) as f64 / 2.0;
    for (index, curve) in panel.curves.iter().enumerate() {
        let aside = if curve.look.mark == Mark::None { 0.0 } else { (index as f64 - middle) * DODGE };
        draw_curve(svg, &axes, curve, aside);
    }
}

fn draw_curve(svg: &mut String, axes: &Axes, curve: &Curve, aside: f64) {
    let Look { colour, mark, solid } = curve.look;
    let at = |point: &Point| [axes.px(point.x) + aside, axes.py(point.y)];
    let mut path = String::new();
    if let (Mark::None, [only]) = (mark, curve.points.as_slice()) {
        // A line without marks would vanish at a single point.
        let [x, y] = at(only);
        let _ = write!(path, "{:.1},{y:.1} {:.1},{y:.1}", x - 40.0, x + 40.0);
    } else {
        for point in &curve.points {
            let [x, y] = at(point);
            let _ = write!(path, " {x:.1},{y:.1}");
        }
    }
    stroke(svg, path.trim(), curve.look);
    for point in &curve.points {
        let [x, y] = at(point);
        if point.spread > 0.0 {
            let (low, high) = (axes.py(point.y - point.spread), axes.py(point.y + point.spread));
            line(svg, [x, low, x, high], colour, 1.2);
            for end in [low, high] {
                line(svg, [x - 3.0, end, x + 3.0, end], colour, 1.2);
            }
        }
        draw_mark(svg, mark, [x, y], colour, solid);
    }
}

fn stroke(svg: &mut String, points: &str, look: Look) {
    let dash = match (look.mark, look.solid) {
        (Mark::None, _) => " stroke-dasharray=\"2 3\"",
        (_, true) => "",
        (_, false) => " stroke-dasharray=\"7 4\"",
    };
    let _ = writeln!(
        svg,
        "<polyline points=\"{points}\" fill=\"none\" stroke=\"{}\" stroke-width=\"2\"{dash}/>",
        look.colour
    );
}

fn draw_mark(svg: &mut String, mark: Mark, [x, y]: [f64; 2], colour: &str, solid: bool) {
    let corners: &[[f64; 2]] = match mark {
        Mark::None => return,
        Mark::Disc => &[],
        Mark::Square => &[[-4.0, -4.0], [4.0, -4.0], [4.0, 4.0], [-4.0, 4.0]],
        Mark::Triangle => &[[-5.0, 4.0], [5.0, 4.0], [0.0, -5.0]],
        Mark::Diamond => &[[-5.5, 0.0], [0.0, -5.5], [5.5, 0.0], [0.0, 5.5]],
    };
    let style =
        format!("fill=\"{}\" stroke=\"{colour}\" stroke-width=\"1.8\"", if solid { colour } else { "#fff" });
    if corners.is_empty() {
        let _ = writeln!(svg, "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"4.5\" {style}/>");
        return;
    }
    let points: Vec<String> = corners.iter().map(|[dx, dy]| format!("{:.1},{:.1}", x + dx, y + dy)).collect();
    let _ = writeln!(svg, "<polygon points=\"{}\" {style}/>", points.join(" "));
}

/// Every name once, in the order of its first appearance.
fn legend(svg: &mut String, figure: &Figure, y: f64) {
    let mut names: Vec<(&str, Look)> = Vec::new();
    for curve in figure.panels.iter().flat_map(|panel| &panel.curves) {
        if names.iter().all(|(name, _)| *name != curve.name) {
            names.push((&curve.name, curve.look));
        }
    }
    let mut x = LEFT;
    for (name, look) in names {
        stroke(svg, &format!("{x:.1},{:.1} {:.1},{:.1}", y - 4.5, x + 34.0, y - 4.5), look);
        draw_mark(svg, look.mark, [x + 17.0, y - 4.5], look.colour, look.solid);
        text(svg, [x + 41.0, y], (13.5, "start"), name);
        x += 41.0 + 8.5 * name.chars().count() as f64 + 22.0;
    }
}

/// The data with half a step of room at both ends.
fn x_range(ticks: &[(f64, String)]) -> [f64; 2] {
    let (Some((first, _)), Some((last, _))) = (ticks.first(), ticks.last()) else { return [0.0, 1.0] };
    let steps = ticks.windows(2).map(|pair| pair[1].0 - pair[0].0);
    let room = 0.5 * steps.fold(f64::INFINITY, f64::min);
    let room = if room.is_finite() && room > 0.0 { room } else { 0.5 * first.abs().max(1.0) };
    [first - room, last + room]
}

fn y_ticks(panel: &Panel) -> Vec<(f64, String)> {
    if panel.scale == Scale::Percent {
        return (0..=4).map(|k| (f64::from(k) * 0.25, format!("{} %", k * 25))).collect();
    }
    let points = || panel.curves.iter().flat_map(|curve| &curve.points);
    if panel.scale == Scale::Log {
        let positive = || points().map(|point| point.y).filter(|y| *y > 0.0);
        return log_ticks(positive().fold(f64::INFINITY, f64::min), positive().fold(0.0, f64::max));
    }
    let low = points().map(|point| point.y - point.spread).fold(f64::INFINITY, f64::min);
    let high = points().map(|point| point.y + point.spread).fold(f64::NEG_INFINITY, f64::max);
    linear_ticks(low, high)
}

/// Multiples of 1, 2, 2.5 or 5 times a power of ten that enclose the data in about five steps.
fn linear_ticks(low: f64, high: f64) -> Vec<(f64, String)> {
    if !(low.is_finite() && high.is_finite()) {
        return vec![(0.0, "0".into()), (1.0, "1".into())];
    }
    let span = (high - low).max(0.02 * high.abs()).max(1e-6);
    let rough = span / 4.0;
    let power = 10f64.powf(rough.log10().floor());
    let step = [1.0, 2.0, 2.5, 5.0, 10.0].map(|m| m * power).into_iter().find(|step| *step >= rough * 0.999);
    let step = step.unwrap_or(power * 10.0);
    let (first, mut last) = ((low / step + 1e-9).floor(), (high / step - 1e-9).ceil());
    if last <= first {
        last = first + 1.0;
    }
    let decimals = (0..6).find(|d| is_whole(step * 10f64.powi(*d))).unwrap_or(6) as usize;
    (0..=(last - first) as usize)
        .map(|k| (first + k as f64) * step)
        .map(|value| (value, format!("{value:.decimals$}")))
        .collect()
}

fn is_whole(value: f64) -> bool {
    (value - value.round()).abs() < 1e-6
}

/// Powers of ten that enclose the data.
fn log_ticks(low: f64, high: f64) -> Vec<(f64, String)> {
    if !(low.is_finite() && high > 0.0) {
        return vec![(0.1, "0.1".into()), (1.0, "1".into())];
    }
    let first = low.log10().floor() as i32;
    let last = (high.log10().ceil() as i32).max(first + 1);
    (first..=last)
        .map(|power| {
            let value = 10f64.powi(power);
            let decimals = usize::try_from(-power).unwrap_or(0);
            (value, format!("{value:.decimals$}"))
        })
        .collect()
}

fn line(svg: &mut String, [x1, y1, x2, y2]: [f64; 4], colour: &str, width: f64) {
    let _ = writeln!(
        svg,
        "<line x1=\"{x1:.1}\" y1=\"{y1:.1}\" x2=\"{x2:.1}\" y2=\"{y2:.1}\" stroke=\"{colour}\" \
         stroke-width=\"{width}\"/>"
    );
}

fn text(svg: &mut String, [x, y]: [f64; 2], (size, anchor): (f64, &str), text: &str) {
    let _ = writeln!(
        svg,
        "<text x=\"{x:.1}\" y=\"{y:.1}\" font-size=\"{size}\" text-anchor=\"{anchor}\" \
         fill=\"{INK}\">{}</text>",
        escape(text)
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(ticks: Vec<(f64, String)>) -> Vec<String> {
        ticks.into_iter().map(|(_, label)| label).collect()
    }

    #[test]
    fn ticks_are_round_and_enclose_the_data() {
        assert_eq!(labels(linear_ticks(1.03, 1.38)), ["1.0", "1.1", "1.2", "1.3", "1.4"]);
        assert_eq!(labels(linear_ticks(22.0, 71.0)), ["20", "40", "60", "80"]);
        assert_eq!(labels(log_ticks(0.004, 3.0)), ["0.001", "0.01", "0.1", "1", "10"]);
        assert_eq!(labels(linear_ticks(f64::INFINITY, f64::NEG_INFINITY)), ["0", "1"]);
        assert!(linear_ticks(1.0, 1.0).len() >= 2);
    }

    fn figure(scale: Scale, ys: &[f64]) -> Figure {
        let points = ys.iter().zip([20.0, 30.0, 40.0]).map(|(y, x)| Point { x, y: *y, spread: 0.0 });
        let look = Look { colour: "#123456", mark: Mark::Square, solid: true };
        let curve = Curve { name: "A<B".into(), look, points: points.collect() };
        let bound = Look { colour: "#000", mark: Mark::None, solid: true };
        let bound = Curve {
            name: "bound".into(),
            look: bound,
            points: vec![Point { x: 20.0, y: ys[0], spread: 0.5 }],
        };
        Figure {
            title: "t".into(),
            subtitle: "s".into(),
            x_label: "n".into(),
            x_ticks: vec![(20.0, "20".into()), (30.0, "30".into()), (40.0, "40".into())],
            panels: vec![Panel { title: "p".into(), scale, curves: vec![curve, bound] }],
        }
    }

    #[test]
    fn higher_values_lie_higher_and_names_are_escaped() {
        let svg = figure_svg(&figure(Scale::Percent, &[0.0, 0.5, 1.0]));
        let line = svg.lines().find(|line| line.starts_with("<polyline")).unwrap();
        let heights: Vec<f64> = line
            .split('"')
            .nth(1)
            .unwrap()
            .split(' ')
            .map(|pair| pair.split_once(',').unwrap().1.parse().unwrap())
            .collect();
        assert_eq!(heights, [TOP + PANEL_HEIGHT, TOP + PANEL_HEIGHT / 2.0, TOP]);
        assert!(svg.contains("A&lt;B") && !svg.contains("A<B"));
        assert_eq!(svg.matches(">bound</text>").count(), 1);
    }

    #[test]
    fn equal_steps_on_a_log_axis_are_equal_factors() {
        let axes = Axes { left: 0.0, x: [0.0, 1.0], y: [0.001, 10.0], log: true };
        let step = |a: f64, b: f64| axes.py(a) - axes.py(b);
        assert!((step(0.001, 0.01) - step(1.0, 10.0)).abs() < 1e-9);
        assert_eq!(axes.py(0.0), TOP + PANEL_HEIGHT);
    }
}
