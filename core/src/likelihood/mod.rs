//! The likelihood of a measured displacement given the acceleration: innovations of both through one filter.

pub mod covariance;
pub mod play;
pub mod response;
pub mod whitening;
