//! Trackers: from the pixels of a frame to the translation of a target, and what its image says of that.
//!
//! Splines on the pixel grid, correlation of a template and its peak (`template`), and maximum-likelihood kernels in
//! blocks and of the whole window (`registration`). Arrays are row after row.

pub mod angles;
pub mod bank;
pub mod blocks;
pub mod chain;
pub mod climb;
pub mod codec;
pub mod correlation;
pub mod counts;
pub mod doubled;
pub mod fair_variance;
pub mod fine_spline;
pub mod grid;
pub mod image;
pub mod integral;
pub mod interpolate;
pub mod kept;
pub mod kernels;
pub mod learning;
pub mod lens;
pub mod light;
pub mod light_watch;
pub mod matching;
pub mod matrix;
pub mod motion;
pub mod normal;
pub mod patch;
pub mod peak;
pub mod phase;
pub mod phase_axis;
pub mod picture;
pub mod picture_noise;
pub mod picture_watch;
pub mod products;
pub mod reference;
pub mod registration;
pub mod running_median;
pub mod spline;
pub mod steerable;
pub mod surf;
pub mod surf_descriptor;
pub mod template;
pub mod tracker;
pub mod undisturbed;
pub mod vector;
pub mod watch;
pub mod window_tables;
