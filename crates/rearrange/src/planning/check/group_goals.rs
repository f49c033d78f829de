//! Whether every goal of a group has a member of its own.
//!
//! In: for each goal, the members that are there. Out: a goal that is left over when every member takes one
//! goal at most. Two goals may be the same pose (within the given overlap), and then one member does not
//! serve both. Pure.

/// A goal for which no member is left in any assignment of the goals up to it; `None` when all are served.
pub(super) fn unserved(standing: &[Vec<usize>]) -> Option<usize> {
    let members = standing.iter().flatten().max().map_or(0, |last| last + 1);
    let mut taken: Vec<Option<usize>> = vec![None; members];
    (0..standing.len()).find(|&goal| {
        let mut requested = vec![false; members];
        !serve(goal, standing, &mut taken, &mut requested)
    })
}

/// Finds a member for `goal`, moving others to their second choice; each member is tried once.
fn serve(goal: usize, standing: &[Vec<usize>], taken: &mut [Option<usize>], requested: &mut [bool]) -> bool {
    for &member in &standing[goal] {
        if std::mem::replace(&mut requested[member], true) {
            continue;
        }
        let free = match taken[member] {
            None => true,
            Some(other) => serve(other, standing, taken, requested),
        };
        if free {
            taken[member] = Some(goal);
            return true;
        }
    }
    false
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_member_serves_one_goal_and_gives_way() {
        assert_eq!(unserved(&[vec![0], vec![0]]), Some(1));
        assert_eq!(unserved(&[vec![0, 1], vec![0]]), None, "the first goal moves to member 1");
        assert_eq!(unserved(&[vec![0, 1], vec![0], vec![1]]), Some(2));
        assert_eq!(unserved(&[vec![4], vec![]]), Some(1));
        assert_eq!(unserved(&[]), None);
    }
}
