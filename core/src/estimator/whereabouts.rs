//! That a structure stays near to where it was: what bounds the displacement after a time without measurements, in which
//! the integrated acceleration alone would let it be hundreds of metres away.

use super::hypotheses::Hypotheses;
use super::hypothesis::Hypothesis;
use super::innovation::Work;
use super::layout::motion_of;
use super::matrix::quadratic;
use super::motion::AxisMotion;
use super::start::MAX_M;
use super::update::update;
use super::way_back::WayBack;

/// Variance of how far a structure is from where it was last known to be, m².
pub const VARIANCE_M2: f64 = MAX_M * MAX_M;

/// Notes where the structure is along each axis; where that is less certain than [`MAX_M`], all hypotheses take as
/// measured that it is where it was when it was last certain, to that standard deviation.
pub fn keep_near(
    hyps: &mut Hypotheses,
    motion: &mut [AxisMotion],
    at_s: f64,
    mut back: Option<&mut WayBack>,
    work: &mut Work,
) {
    for (a, axis) in motion.iter_mut().enumerate() {
        let best = hyps.best();
        let (place_m, variance_m2) = placed(best, motion_of(a));
        if variance_m2 <= VARIANCE_M2 {
            axis.known_m = place_m;
            continue;
        }
        for (b, hyp) in hyps.all_mut().iter_mut().enumerate().rev() {
            let total = take_near(hyp, motion_of(a), axis.known_m, work);
            if let Some(back) = back.as_deref_mut().filter(|_| b == 0) {
                back.leave_near(at_s, a, total, work);
            }
        }
    }
}

/// Displacement of the axis whose first state is `i`, m, and its variance, m², with the parameters' part.
fn placed(hyp: &Hypothesis, i: usize) -> (f64, f64) {
    let (value, sensitivities) = hyp.x.row(i).split_at(1);
    let reported: f64 = hyp.parameters.iter().zip(sensitivities).map(|(one, sensitivity)| one * sensitivity).sum();
    (value[0] + reported, hyp.p[(i, i)] + quadratic(sensitivities, &hyp.spread))
}

/// Takes that the displacement, state `i`, is `known_m`; the innovation's variance is returned, its sensitivities and
/// the gain stay in `work`. Of the parameters it tells nothing.
fn take_near(hyp: &mut Hypothesis, i: usize, known_m: f64, work: &mut Work) -> f64 {
    for (out, &one) in work.e.iter_mut().zip(hyp.x.row(i)) {
        *out = -one;
    }
    work.e[0] += known_m;
    work.gain.copy_from_slice(hyp.p.row(i));
    let total = work.gain[i] + VARIANCE_M2;
    update(&mut hyp.x, &mut hyp.p, &mut work.gain, &work.e, total);
    // The sums of the steps that may have been were of the states before.
    hyp.clear_tests();
    total
}
