//! A radar target's phase: unwrapping by itself and inside a filter, and whether the target is seen.

pub mod blockage;
pub mod follow;
pub mod unwrap;
