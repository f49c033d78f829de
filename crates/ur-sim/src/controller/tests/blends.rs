//! Moves of a program that blend, and those that cannot.

use super::*;

#[test]
fn blended_moves_of_a_program_do_not_stop() {
    let mut controller = running();
    upload(
        &mut controller,
        "def m():\n i = 1\n while i <= 4:\n  movej([0.4 * i,-1.57,1.57,-1.57,-1.57,0], a=3, v=1, r=0.05)\n  \
         i = i + 1\n \
         end\n movej([2,-1.57,1.57,-1.57,-1.57,0], a=3, v=1)\nend\n",
    );
    (0..250).for_each(|_| controller.frame());
    let mut slowest = f64::INFINITY;
    while controller.core.mover.q().0[0] < 1.6 {
        controller.frame();
        slowest = slowest.min(controller.core.mover.qd()[0]);
    }
    assert!(slowest > 0.6, "slowed down to {slowest} rad/s");
}

#[test]
fn a_move_whose_blend_overlaps_the_one_before_is_skipped() {
    // From 0.4 to 0.6 rad the tool goes some 0.1 m: as far as the larger radii reach.
    for (radius, skipped) in [(0.03, false), (0.09, true)] {
        let mut controller = running();
        upload(
            &mut controller,
            &format!(
                "def m():\n movej([0.4,-1.57,1.57,-1.57,-1.57,0], a=3, v=1, r={radius})\n \
                 movej([0.6,-1.57,1.57,-1.57,-1.57,0], a=3, v=1, r={radius})\n \
                 movej([0.5,-1.2,1.57,-1.57,-1.57,0], a=3, v=1)\nend\n"
            ),
        );
        let mut farthest = f64::NEG_INFINITY;
        for _ in 0..2000 {
            controller.frame();
            farthest = farthest.max(controller.core.mover.q().0[0]);
        }
        let said = messages(&mut controller).concat();
        assert_eq!(said.contains("Overlapping blends in movej"), skipped, "{radius}: {said}");
        assert_eq!(farthest < 0.51, skipped, "{radius}: {farthest} rad");
        assert!((controller.core.mover.q().0[0] - 0.5).abs() < 1e-6, "the last move is made");
    }
}
