//! From instants to a grid and back: a local cubic spline through uneven knots, and a filter read between its samples.
//!
//! Each interval uses at most [`SIDE`] knots on either side of it, so that its values do not depend on what is farther
//! away. A cubic spline forgets a knot that is k knots away by 0.268 to the power k: 0.5 % at four.

/// Knots used on each side of an interval.
pub const SIDE: usize = 4;

/// Values (n,) of local cubic splines through uneven knots at increasing instants, or None where an instant lies in no
/// interval that is bridged.
///
/// `at_s` (n,), `knot_s` (k,): s, increasing; `value` (k,): not finite where a knot does not count; `longest_s`:
/// longest interval that is bridged; `reach_s`: how far behind the start of an interval a knot is looked at.
pub fn spline(at_s: &[f64], knot_s: &[f64], value: &[f64], longest_s: f64, reach_s: f64) -> Vec<Option<f64>> {
    let knots = Knots::new(knot_s, value, longest_s);
    let mut next = 0;
    let mut piece: Option<(usize, Cubic)> = None;
    let mut values = Vec::with_capacity(at_s.len());
    for &at in at_s {
        while next < knot_s.len() && knot_s[next] <= at {
            next += 1;
        }
        let bridged = |left: &usize| knots.bridged.get(*left) == Some(&true);
        let left = next.checked_sub(1);
        // An instant exactly on a knot after which nothing is bridged belongs to the interval before it.
        let before = left.filter(|&left| knot_s[left] == at).and_then(|left| left.checked_sub(1));
        let interval = left.filter(bridged).or(before.filter(bridged));
        values.push(interval.map(|left| {
            let cubic = match piece {
                Some((of, cubic)) if of == left => cubic,
                _ => knots.cubic(left, reach_s),
            };
            piece = Some((left, cubic));
            cubic.at(at - knot_s[left])
        }));
    }
    values
}

/// Knots with the length and slope of the interval after each, and whether it is bridged.
struct Knots<'a> {
    knot_s: &'a [f64],
    value: &'a [f64],
    step: Vec<f64>,
    slope: Vec<f64>,
    bridged: Vec<bool>,
}

impl<'a> Knots<'a> {
    fn new(knot_s: &'a [f64], value: &'a [f64], longest_s: f64) -> Self {
        let step: Vec<f64> = knot_s.windows(2).map(|two| two[1] - two[0]).collect();
        let slope: Vec<f64> = value.windows(2).zip(&step).map(|(two, h)| (two[1] - two[0]) / h).collect();
        let bridged = step.iter().zip(&slope).map(|(&h, slope)| h <= longest_s && slope.is_finite()).collect();
        Self { knot_s, value, step, slope, bridged }
    }

    /// The cubic over the interval after the knot `left`.
    fn cubic(&self, left: usize, reach_s: f64) -> Cubic {
        let (first, last) = self.used(left, reach_s);
        let h = self.step[left];
        let bends = self.bends(first, left, last);
        Cubic {
            a: self.value[left],
            b: self.slope[left] - h * (2.0 * bends[0] + bends[1]) / 6.0,
            c: 0.5 * bends[0],
            d: (bends[1] - bends[0]) / (6.0 * h),
        }
    }

    /// First and last knot that the interval after `left` uses.
    fn used(&self, left: usize, reach_s: f64) -> (usize, usize) {
        let (mut first, mut last) = (left, left + 1);
        while first > 0 && left - first < SIDE && self.bridged[first - 1] {
            first -= 1;
        }
        while last - left <= SIDE
            && self.bridged.get(last) == Some(&true)
            && self.knot_s[last + 1] <= self.knot_s[left] + reach_s
        {
            last += 1;
        }
        (first, last)
    }

    /// Second derivatives at the knots `left` and `left + 1` of the spline through first … last.
    ///
    /// The tridiagonal system is eliminated from both ends towards the interval; over the two end intervals the second
    /// derivative is constant.
    fn bends(&self, first: usize, left: usize, last: usize) -> [f64; 2] {
        let h = self.step[left];
        let before =
            (first + 1..=left).fold(None, |eliminated, i| Some(self.eliminated(eliminated, i, self.step[i - 1])));
        let after =
            (left + 1..last).rev().fold(None, |eliminated, i| Some(self.eliminated(eliminated, i, self.step[i])));
        match (before, after) {
            (None, None) => [0.0; 2],
            (None, Some(s)) => [s.right / (s.diagonal + h); 2],
            (Some(r), None) => [r.right / (r.diagonal + h); 2],
            (Some(r), Some(s)) => {
                let det = r.diagonal * s.diagonal - h * h;
                [(s.diagonal * r.right - h * s.right) / det, (r.diagonal * s.right - h * r.right) / det]
            }
        }
    }

    /// The equation of the knot `i` after those between it and the end are eliminated; `outer`: its interval on that
    /// side.
    fn eliminated(&self, towards_the_end: Option<Eliminated>, i: usize, outer: f64) -> Eliminated {
        // At the end the second derivative is constant over the interval.
        let share = towards_the_end.map_or(-1.0, |one| outer / one.diagonal);
        let right = 6.0 * (self.slope[i] - self.slope[i - 1]);
        Eliminated {
            diagonal: 2.0 * (self.step[i - 1] + self.step[i]) - share * outer,
            right: towards_the_end.map_or(right, |one| right - share * one.right),
        }
    }
}

/// A row of the tridiagonal system that only couples to its neighbour towards the interval.
#[derive(Clone, Copy)]
struct Eliminated {
    diagonal: f64,
    right: f64,
}

/// A cubic from the start of its interval.
#[derive(Clone, Copy)]
struct Cubic {
    a: f64,
    b: f64,
    c: f64,
    d: f64,
}

impl Cubic {
    fn at(&self, t: f64) -> f64 {
        self.a + t * (self.b + t * (self.c + t * self.d))
    }
}

/// A filter from a series to a wanted quantity, read between samples.
///
/// `wanted` (n,): from the series to the quantity; `bend` (n,): to its second derivative times the square of the step;
/// n odd. Between two samples the quantity runs as the cubic with these second derivatives.
pub struct Taps<'a> {
    /// Taps of the quantity.
    pub wanted: &'a [f64],
    /// Taps of its second derivative.
    pub bend: &'a [f64],
}

/// The filtered series at the fraction `fraction` (m,), 0 to 1, after the samples `index` (m,); None where an index is
/// nearer to an end of the series than half a filter (and one after it).
pub fn filtered_at(series: &[f64], index: &[i64], fraction: &[f64], taps: &Taps) -> Option<Vec<f64>> {
    let half = taps.wanted.len() / 2;
    index
        .iter()
        .zip(fraction)
        .map(|(&index, &b)| {
            let start = usize::try_from(index).ok()?.checked_sub(half)?;
            let samples = series.get(start..=start + taps.wanted.len())?;
            let (here, next) = (&samples[..taps.wanted.len()], &samples[1..]);
            let a = 1.0 - b;
            let bent = (a * a * a - a) * product(taps.bend, here) + (b * b * b - b) * product(taps.bend, next);
            Some(a * product(taps.wanted, here) + b * product(taps.wanted, next) + bent / 6.0)
        })
        .collect()
}

/// Sum of products in four lanes, so that the processor takes four at a time; the order of summing is fixed.
fn product(one: &[f64], other: &[f64]) -> f64 {
    let (fours, others) = (one.chunks_exact(4), other.chunks_exact(4));
    let rest: f64 = fours.remainder().iter().zip(others.remainder()).map(|(a, b)| a * b).sum();
    let mut lanes = [0.0; 4];
    for (a, b) in fours.zip(others) {
        for (lane, (a, b)) in lanes.iter_mut().zip(a.iter().zip(b)) {
            *lane += a * b;
        }
    }
    (lanes[0] + lanes[1]) + (lanes[2] + lanes[3]) + rest
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn uneven(count: usize) -> Vec<f64> {
        (0..count).map(|k| k as f64 + 0.3 * (1.7 * k as f64).sin()).collect()
    }

    proptest! {
        /// A parabola's second derivative is constant, as that of the spline is over its two end intervals.
        #[test]
        fn a_parabola_is_kept(a in -2.0..2.0f64, b in -2.0..2.0f64, c in -0.5..0.5f64) {
            let parabola = |t: f64| a + t * (b + t * c);
            let knot_s = uneven(30);
            let value: Vec<f64> = knot_s.iter().map(|&t| parabola(t)).collect();
            let at_s: Vec<f64> = (0..400).map(|k| knot_s[0] + (knot_s[29] - knot_s[0]) * f64::from(k) / 400.0).collect();
            for (at, found) in at_s.iter().zip(spline(&at_s, &knot_s, &value, 3.0, 6.0)) {
                // Values are up to 500.
                prop_assert!((found.unwrap() - parabola(*at)).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn no_interval_longer_than_the_longest_and_no_unknown_knot_is_bridged() {
        let knot_s = [0.0, 1.0, 2.0, 6.0, 7.0, 8.0];
        let value = [0.0, 1.0, 2.0, 3.0, f64::NAN, 5.0];
        let found = spline(&[-0.1, 0.0, 1.5, 2.0, 4.0, 6.5, 7.5, 8.0, 8.1], &knot_s, &value, 2.0, 5.5);
        let given: Vec<bool> = found.iter().map(Option::is_some).collect();
        assert_eq!(given, [false, true, true, true, false, false, false, false, false]);
    }

    #[test]
    fn without_knots_nothing_is_bridged() {
        assert_eq!(spline(&[0.0, 1.0], &[], &[], 1.0, 1.0), [None, None]);
        assert_eq!(spline(&[0.0, 1.0], &[0.0], &[1.0], 1.0, 1.0), [None, None]);
    }

    #[test]
    fn a_filter_between_samples_gives_the_cubic() {
        // The series itself and its second difference: a cubic's own, so that it is read exactly.
        let series: Vec<f64> = (0..12).map(|k| f64::from(k).powi(3)).collect();
        let taps = Taps { wanted: &[0.0, 1.0, 0.0], bend: &[1.0, -2.0, 1.0] };
        let found = filtered_at(&series, &[3, 5], &[0.25, 0.5], &taps).unwrap();
        assert!((found[0] - 3.25f64.powi(3)).abs() < 1e-12 && (found[1] - 5.5f64.powi(3)).abs() < 1e-12);
        assert_eq!(filtered_at(&series, &[0], &[0.0], &taps), None);
        assert_eq!(filtered_at(&series, &[10], &[0.0], &taps), None);
        assert_eq!(filtered_at(&series, &[-4], &[0.0], &taps), None);
    }
}
