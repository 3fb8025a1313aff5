//! What waits of a point: samples and measurements, each in the order of their stamps.

use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// One value of a sensor.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Reading {
    /// Its stamp, ns.
    pub time_ns: i64,
    /// From one to the next in its block, ns.
    pub step_ns: i64,
    /// m/s² or m.
    pub value: f64,
}

/// Readings of one sensor that wait.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Queue(VecDeque<Reading>);

impl Queue {
    /// Puts a reading into its place; false where one with its stamp waits already, or `most` wait.
    #[inline]
    pub fn put(&mut self, one: Reading, most: usize) -> bool {
        if self.0.len() >= most {
            return false;
        }
        if self.0.back().is_none_or(|last| last.time_ns < one.time_ns) {
            self.0.push_back(one);
            return true;
        }
        let place = self.0.partition_point(|other| other.time_ns < one.time_ns);
        let is_new = self.0[place].time_ns != one.time_ns;
        if is_new {
            self.0.insert(place, one);
        }
        is_new
    }

    /// How many wait.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether none waits.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Whether `most` wait.
    pub fn is_full(&self, most: usize) -> bool {
        self.0.len() >= most
    }

    /// The first one.
    #[inline]
    pub fn first(&self) -> Option<&Reading> {
        self.0.front()
    }

    /// Takes the first one where its stamp is at most `until_ns`.
    #[inline]
    pub fn take(&mut self, until_ns: i64) -> Option<Reading> {
        self.0.front().filter(|one| one.time_ns <= until_ns)?;
        self.0.pop_front()
    }

    /// The stamp up to which nothing is missing, from `after_ns` on; None: everything is.
    pub fn reach_ns(&self, after_ns: Option<i64>) -> Option<i64> {
        let mut reach = after_ns;
        for one in &self.0 {
            if reach.is_some_and(|reach| is_hole(one.time_ns - reach, one.step_ns)) {
                break;
            }
            reach = Some(one.time_ns);
        }
        reach
    }
}

/// Whether readings are missing in a time between two, given the step between readings.
#[inline]
pub fn is_hole(between_ns: i64, step_ns: i64) -> bool {
    between_ns > step_ns + step_ns / 2
}
