//! A radar target's phase: unwrapping.

pub mod unwrap;
