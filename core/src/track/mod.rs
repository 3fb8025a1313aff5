//! What is computed on images: where a target is, and what its picture says of that.

pub mod angles;
pub mod doubled;
pub mod image;
pub mod integral;
pub mod interpolate;
pub mod lens;
pub mod light;
pub mod matching;
pub mod patch;
pub mod phase;
pub mod phase_axis;
pub mod picture;
pub mod picture_noise;
pub mod steerable;
pub mod surf;
pub mod surf_descriptor;
pub mod vector;
