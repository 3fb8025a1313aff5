//! The estimator of one measuring point: samples of acceleration and measurements in, displacement with its band out.
//!
//! The motion of each axis is three states: displacement x, velocity v and bias b of the accelerometer, driven by the
//! measured acceleration as in [`motion`]. Every other state is constant or walks at random and has its name in
//! [`layout`]. A measurement y, in the sensor's own unit, is
//!
//! ```text
//! y = units_per_m · ((1 − e) x + z + s + r + v d + blur (a − b)) + noise
//! ```
//!
//! with zero z, the shift s of this zero since, the error r of the reference that is compared with (of a sensor without
//! any its slow error, a first-order Gauss-Markov process), relative scale error e and clock offset d; see [`row`]. The
//! two last are parameters, and so is the share of the measured acceleration that is the accelerometer's wrong gain:
//! constants whose effect on every estimate and innovation is carried along as a sensitivity. The columns of the state
//! matrix X (n, 1 + parameters) are the estimate, and what one unit of each parameter moves it by; they obey the same
//! equations and share the gains, so that covariance and gains are those of the filter without parameters (separate
//! bias estimation: B. Friedland, Treatment of bias in recursive filtering, IEEE Trans. Automat. Contr. 14 (1969)
//! 359-367, doi 10.1109/TAC.1969.1099223).
//!
//! What a measurement means is decided by hypotheses ([`hypotheses`], [`cause`]); `smoother` and `lag` run the filter
//! again with what was decided, and then back in time ([`smoother`]).

pub mod acceptance;
pub mod cause;
pub mod clock_bank;
pub mod clocks;
pub mod coast;
pub mod decided;
pub mod hypotheses;
pub mod hypothesis;
pub mod innovation;
pub mod lag;
pub mod layout;
pub mod matrix;
pub mod model;
pub mod motion;
pub mod predict;
pub mod printed;
pub mod reports;
pub mod row;
pub mod rows;
pub mod run;
pub mod samples;
pub mod second_pass;
pub mod settings;
pub mod situation;
pub mod slow;
pub mod smoother;
pub mod start;
pub mod state;
pub mod steps;
pub mod stream;
pub mod suspicion;
pub mod update;
pub mod waiting;
pub mod way_back;

#[cfg(test)]
mod tests;
