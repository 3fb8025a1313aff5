//! How lively a motion is: the running mean square of an acceleration.

/// Mean square (n,) of values (n,) less `mean`, over what came up to each of them: exponential, `kept` is the share
/// that the mean before a sample has in the one after it. `before`: the mean square before the first value.
pub fn mean_square(value: &[f64], mean: f64, before: f64, kept: f64) -> Vec<f64> {
    let mut power = before;
    let squares = value.iter().map(|&value| {
        let off = value - mean;
        power = (1.0 - kept) * (off * off) + kept * power;
        power
    });
    squares.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_the_sum_of_all_squares_each_with_its_weight_and_the_same_in_any_cutting() {
        let value: Vec<f64> = (0..40).map(|k| (0.7 * f64::from(k)).sin() + 0.1).collect();
        let whole = mean_square(&value, 0.1, 2.0, 0.9);
        let first = mean_square(&value[..17], 0.1, 2.0, 0.9);
        assert_eq!(whole[17..], mean_square(&value[17..], 0.1, first[16], 0.9));
        for (n, &power) in whole.iter().enumerate() {
            let weighted = (0..=n).map(|k| 0.1 * 0.9f64.powi((n - k) as i32) * (value[k] - 0.1).powi(2));
            assert!((power - (weighted.sum::<f64>() + 2.0 * 0.9f64.powi(n as i32 + 1))).abs() < 1e-12);
        }
    }
}
