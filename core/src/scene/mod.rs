//! What simulated cameras see and how simulated structures move.

pub mod beam;
pub mod paint;
pub mod render;
pub mod warp;
