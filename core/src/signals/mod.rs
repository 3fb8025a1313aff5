//! Series of samples: arrays in, arrays out; no sensor is known here.

pub mod equal_runs;
pub mod lively;
pub mod resample;
