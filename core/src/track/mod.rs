//! Trackers: from the pixels of a frame to the translation of a target.
//!
//! Splines on the pixel grid, correlation of a template and its peak (`template`), and maximum-likelihood kernels in blocks
//! and of the whole window (`registration`). Arrays are row after row.

pub mod bank;
pub mod blocks;
pub mod climb;
pub mod correlation;
pub mod fine_spline;
pub mod grid;
pub mod kernels;
pub mod learning;
pub mod matrix;
pub mod peak;
pub mod pixels;
pub mod reference;
pub mod registration;
pub mod spline;
pub mod template;
pub mod undisturbed;
pub mod vectors;
pub mod window_tables;
