//! What is computed on images: where a target is, and what its picture says of that.

pub mod image;
pub mod interpolate;
pub mod light;
pub mod picture;
pub mod picture_noise;
pub mod vector;
