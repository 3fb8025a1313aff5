//! Runs of equal values, and from which length on a run is longer than chance makes it.
//!
//! A run of n neighbours that are equal has the chance pⁿ, p the share of equal neighbours lately. A run counts as
//! frozen from the length on of which chance makes one in 1 / [`CHANCE`].

/// Chance below which a run is none: once in four months at 100 Hz.
pub const CHANCE: f64 = 1e-9;

/// A run at a sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Run {
    /// Equal values up to the sample, itself included; 0 where it is no number.
    pub length: i64,
    /// The length from which on the run counts as frozen.
    pub frozen: i64,
    /// Share of equal neighbours before the run.
    pub share: f64,
}

/// Runs (n,) of equal values (n,), going on from the last value before them with the length of its run and its share.
///
/// `forget`: share of a new neighbour in the running share; `gentle`: a run that ends with a step of at most this was
/// rest or chance. Any cutting of the values gives the same.
pub fn follow(value: &[f64], before: (f64, i64, f64), forget: f64, gentle: f64) -> Vec<Run> {
    let (mut last, mut length, mut share) = before;
    let mut frozen = by_chance(share, forget);
    value
        .iter()
        .map(|&value| {
            if value == last {
                length += 1;
            } else {
                if length > 1 && (length < frozen || (value - last).abs() <= gentle) {
                    share = 1.0 - (1.0 - share) * (1.0 - forget).powf((length - 1) as f64);
                }
                length = i64::from(!value.is_nan());
                share *= 1.0 - forget;
                frozen = by_chance(share, forget);
            }
            last = value;
            Run { length, frozen, share }
        })
        .collect()
}

fn by_chance(share: f64, min_share: f64) -> i64 {
    1 + (CHANCE.ln() / share.max(min_share).min(1.0 - 1e-6).ln()).ceil() as i64
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn any_cutting_gives_the_same(value in prop::collection::vec(0..3u8, 1..200), cut in 0..200usize) {
            let value: Vec<f64> = value.into_iter().map(f64::from).collect();
            let cut = cut % value.len();
            let whole = follow(&value, (f64::NAN, 0, 0.9), 0.01, 1.0);
            let mut parts = follow(&value[..cut], (f64::NAN, 0, 0.9), 0.01, 1.0);
            let before = parts.last().map_or((f64::NAN, 0, 0.9), |run| (value[cut - 1], run.length, run.share));
            parts.extend(follow(&value[cut..], before, 0.01, 1.0));
            // What counts as frozen goes by the share at the run's start, so the cut run's own limit may differ.
            for (one, other) in whole.iter().zip(&parts) {
                prop_assert_eq!(one.length, other.length);
                prop_assert_eq!(one.share.to_bits(), other.share.to_bits());
            }
        }
    }
}
