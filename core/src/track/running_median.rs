//! The median of the last N values, one value at a time: a push costs the logarithm of N and a shift of the sorted
//! ones.

use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// The last `N` values in their order, and sorted.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct RunningMedian<const N: usize> {
    last: VecDeque<f64>,
    sorted: Vec<f64>,
}

impl<const N: usize> RunningMedian<N> {
    /// How many values there are.
    pub fn len(&self) -> usize {
        self.sorted.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.sorted.is_empty()
    }

    /// The median; NaN before the first value.
    pub fn value(&self) -> f64 {
        let Some(last) = self.sorted.len().checked_sub(1) else { return f64::NAN };
        0.5 * (self.sorted[last / 2] + self.sorted[last.div_ceil(2)])
    }

    /// Take a finite value; the oldest goes where there are more than `N`.
    pub fn push(&mut self, value: f64) {
        let place = |sorted: &[f64], value: f64| sorted.partition_point(|other| *other < value);
        if self.last.len() >= N {
            let at = self.last.pop_front().map_or(self.sorted.len(), |oldest| place(&self.sorted, oldest));
            let end = (at + 1).min(self.sorted.len());
            self.sorted.drain(at.min(end)..end);
        }
        self.last.push_back(value);
        self.sorted.insert(place(&self.sorted, value), value);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn it_is_the_median_of_the_last_values(values in prop::collection::vec(-9i8..9, 1..40)) {
            let mut median = RunningMedian::<7>::default();
            prop_assert!(median.value().is_nan() && median.is_empty());
            for k in 0..values.len() {
                median.push(f64::from(values[k]));
                let mut last = values[k.saturating_sub(6)..=k].to_vec();
                last.sort_unstable();
                let middle = f64::from(last[(last.len() - 1) / 2]) + f64::from(last[last.len() / 2]);
                prop_assert_eq!((median.value(), median.len()), (0.5 * middle, last.len()));
            }
        }
    }
}
