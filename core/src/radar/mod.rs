//! A radar target's phase: unwrapping on its own and inside a filter, and whether the target is seen.

pub mod blockage;
pub mod follow;
pub mod unwrap;
