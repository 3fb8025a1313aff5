//! What follows a motion through a joint with play (backlash).

/// What follows a path (n,) with a play of a width about it.
pub fn play(path: &[f64], width: f64) -> Vec<f64> {
    let half = 0.5 * width;
    let mut place = path.first().copied().unwrap_or_default();
    path.iter()
        .map(|&value| {
            place = place.max(value - half).min(value + half);
            place
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_stands_while_the_path_is_within_the_play_and_then_goes_along() {
        assert_eq!(play(&[0.0, 0.5, 1.5, 2.0, 1.5, 0.0], 2.0), [0.0, 0.0, 0.5, 1.0, 1.0, 1.0]);
        assert!(play(&[], 1.0).is_empty());
    }
}
