//! The quickest order of a plan's pick-n-places: as many of them, to the same places, in less time.
//!
//! In: a problem, a plan for it, what a sequence of actions takes. Out: the plan with actions taken up
//! earlier or later, as long as that saves time and the independent checker accepts it. Pure; bounded by a
//! number of sequences that are priced, and by `over`.

use rearrange::planning::check::CheckedPlan;
use rearrange::planning::plan::Action;
use rearrange::planning::problem::Problem;

/// Sequences that are priced at most.
const PRICED: usize = 2500;

/// Less than this is no gain, s.
const GAIN_S: f64 = 0.01;

/// The actions in the quickest order that is found by moving one or two neighbours at a time.
pub fn quickest(
    problem: &Problem,
    actions: Vec<Action>,
    seconds: &dyn Fn(&[Action]) -> f64,
    over: &dyn Fn() -> bool,
) -> Vec<Action> {
    let (mut best, mut best_s) = (actions.clone(), seconds(&actions));
    let mut priced = 1;
    while priced < PRICED && !over() {
        let mut tried: Vec<(f64, Vec<Action>)> = neighbours(&best)
            .take(PRICED - priced)
            .take_while(|_| !over())
            .map(|next| (seconds(&next), next))
            .collect();
        priced += tried.len().max(1);
        tried.retain(|(taken, _)| *taken < best_s - GAIN_S);
        tried.sort_by(|a, b| a.0.total_cmp(&b.0));
        let accepted = tried
            .into_iter()
            .take_while(|_| !over())
            .find(|(_, next)| CheckedPlan::new(problem, next).is_ok());
        let Some((taken, next)) = accepted else { break };
        (best, best_s) = (next, taken);
    }
    best
}

/// Every order with one action, or two that follow each other, at another place.
fn neighbours(actions: &[Action]) -> impl Iterator<Item = Vec<Action>> {
    let count = actions.len();
    (1..=2usize).flat_map(move |length| {
        (0..(count + 1).saturating_sub(length)).flat_map(move |from| {
            (0..=count - length).filter(move |to| *to != from).map(move |to| {
                let mut rest = actions.to_vec();
                let moved: Vec<Action> = rest.drain(from..from + length).collect();
                rest.splice(to..to, moved);
                rest
            })
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use rearrange::planning::plan::ActionKind;
    use rearrange::tabletop::parse::parse_instance;

    /// Three discs; the first can go home only after the second has left.
    const TABLE: &str = "\
workspace: {width: 0.5, height: 0.5}
objects:
  - {id: a, footprint: {disc: {radius: 0.03}}, start: [0.1, 0.1, 0.0], goal: [0.3, 0.1, 0.0]}
  - {id: b, footprint: {disc: {radius: 0.03}}, start: [0.3, 0.1, 0.0], goal: [0.3, 0.4, 0.0]}
  - {id: c, footprint: {disc: {radius: 0.03}}, start: [0.1, 0.3, 0.0], goal: [0.1, 0.4, 0.0]}
";

    fn way(actions: &[Action]) -> f64 {
        let mut at = [0.0, 0.0];
        let mut sum = 0.0;
        for action in actions {
            for pose in [&action.from, &action.to] {
                sum += (pose.x - at[0]).hypot(pose.y - at[1]);
                at = [pose.x, pose.y];
            }
        }
        sum
    }

    #[test]
    fn an_order_is_quicker_and_still_a_plan() {
        let instance = parse_instance(TABLE, "table", &|_| None).unwrap();
        let problem = Problem::new(&instance).unwrap();
        let of = |index: usize| {
            let object = &instance.objects[index];
            let (from, to) = (object.start.unwrap(), object.goal.unwrap());
            Action { object: index, from, to, kind: ActionKind::Goal }
        };
        let given = vec![of(2), of(1), of(0)];
        let found = quickest(&problem, given.clone(), &way, &|| false);
        assert_eq!(quickest(&problem, given.clone(), &way, &|| true), given, "no time");
        assert!(way(&found) < way(&given) - GAIN_S, "{found:?}");
        assert!(CheckedPlan::new(&problem, &found).is_ok());
        let order: Vec<usize> = found.iter().map(|action| action.object).collect();
        assert!(order.iter().position(|o| *o == 1) < order.iter().position(|o| *o == 0), "{order:?}");
        // Every other order takes longer, or is none.
        let orders = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];
        let possible = orders.map(|order| order.map(of)).into_iter();
        let possible = possible.filter(|plan| CheckedPlan::new(&problem, plan).is_ok());
        let least = possible.map(|plan| way(&plan)).fold(f64::INFINITY, f64::min);
        assert!(way(&found) < least + 1e-12);
    }
}
