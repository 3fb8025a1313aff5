//! Improbable innovations in a row: outliers, or a shift of the zero or of the structure.
//!
//! Outliers scatter. What shifts at once stays where it is, and where a wrong velocity is the cause, the innovations grow
//! evenly: both lie on a line.

use serde::{Deserialize, Serialize};

/// This many improbable measurements of one sign in a row that lie on a line are no outliers.
const SHIFTED: i8 = 4;
/// They lie on a line where each is no further from that through the first and the one before, in the standard
/// deviations of its distance.
const MAX_OFF_LINE: f64 = 4.0;

/// The improbable innovations since the last probable one: the first and the last one (m), and how many there are,
/// negative where they are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Improbable {
    first_m: f32,
    last_m: f32,
    count: i8,
}

impl Improbable {
    /// Whether the last innovation was improbable.
    pub fn is_begun(&self) -> bool {
        self.count != 0
    }

    /// A probable one has come.
    pub fn end(&mut self) {
        self.count = 0;
    }

    /// By how much an innovation is more than the first one, m.
    pub fn growth_m(&self, innovation: f64) -> f64 {
        innovation - f64::from(self.first_m)
    }

    /// Takes an improbable innovation (m); whether enough have come in a row that lie on a line. white_m2: variance of
    /// the measurements' noise, m².
    pub fn is_shift(&mut self, innovation: f64, white_m2: f64) -> bool {
        let sign = if innovation > 0.0 { 1 } else { -1 };
        let (first, last) = (f64::from(self.first_m), f64::from(self.last_m));
        let steps = f64::from(self.count.abs()) - 1.0;
        let share = if steps > 0.0 { 1.0 / steps } else { 0.0 };
        let off = innovation - last - share * (last - first);
        let variance = (1.0 + (1.0 + share).powi(2) + share * share) * white_m2;
        let on_line = steps < 1.0 || off * off <= MAX_OFF_LINE * MAX_OFF_LINE * variance;
        let goes_on = self.count * sign > 0 && on_line;
        self.count = if goes_on { self.count + sign } else { sign };
        self.first_m = if goes_on { self.first_m } else { innovation as f32 };
        self.last_m = innovation as f32;
        self.count.abs() >= SHIFTED
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// After how many of these innovations (m), of measurements with 1 mm of noise, there is a shift.
    fn shift_after(innovations: &[f64]) -> Option<usize> {
        let mut improbable = Improbable::default();
        innovations.iter().position(|&innovation| improbable.is_shift(innovation, 1e-6)).map(|place| place + 1)
    }

    #[test]
    fn what_lies_on_a_line_is_a_shift() {
        assert_eq!(shift_after(&[0.020, 0.021, 0.019, 0.020]), Some(4));
        assert_eq!(shift_after(&[-0.010, -0.020, -0.030, -0.040]), Some(4));
    }

    #[test]
    fn what_scatters_or_changes_its_sign_is_none() {
        assert_eq!(shift_after(&[0.020, 0.080, 0.030, 0.060, 0.010, 0.070]), None);
        assert_eq!(shift_after(&[0.020, 0.020, 0.020, -0.020, -0.020, -0.020]), None);
    }

    #[test]
    fn a_probable_one_ends_the_row() {
        let mut improbable = Improbable::default();
        assert!((0..3).all(|_| !improbable.is_shift(0.02, 1e-6)));
        improbable.end();
        assert!(!improbable.is_begun() && !improbable.is_shift(0.02, 1e-6));
    }
}
