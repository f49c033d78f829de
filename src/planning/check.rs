//! stub until the checker lands
use crate::planning::plan::Action;
use crate::planning::problem::Problem;
#[derive(Clone, Debug)]
pub struct CheckedPlan(Vec<Action>);
#[derive(Debug)]
pub struct PlanFault(pub String);
impl CheckedPlan {
    pub fn new(problem: &Problem, actions: &[Action]) -> Result<CheckedPlan, PlanFault> {
        let mut now: Vec<_> = problem.objects.iter().map(|o| o.start).collect();
        for (k, a) in actions.iter().enumerate() {
            if now[a.object] != a.from { return Err(PlanFault(format!("{k}: from"))); }
            if !problem.fits(a.object, &a.to) { return Err(PlanFault(format!("{k}: fits"))); }
            for j in 0..now.len() {
                if j != a.object && !problem.clear(a.object, &a.to, j, &now[j]) { return Err(PlanFault(format!("{k}: hits {j}"))); }
            }
            now[a.object] = a.to;
        }
        for (o, p) in problem.objects.iter().zip(&now) {
            if o.goal.is_some_and(|g| !g.same(p)) { return Err(PlanFault("goal".into())); }
        }
        Ok(CheckedPlan(actions.to_vec()))
    }
    pub fn actions(&self) -> &[Action] { &self.0 }
}
