//! The states of the filter by their names.
//!
//! The motion of all axes comes first, three states an axis; behind it come states that are constant or walk at random.
//! A further one is a name here, the density of its walk, and entries in the rows of what it moves ([`super::row`]).

use super::matrix::Matrix;
use super::settings::Settings;
use serde::{Deserialize, Serialize};

/// States of the motion along one axis: displacement, velocity, bias.
pub const MOTION_STATES: usize = 3;

/// The name of a state; an axis or a channel by its number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum State {
    /// Displacement along an axis, m.
    Displacement(usize),
    /// Velocity along an axis, m/s.
    Velocity(usize),
    /// Bias of the accelerometer along an axis, m/s².
    Bias(usize),
    /// Displacement of an axis at the instant that rows count from, m.
    Datum(usize),
    /// Zero of a channel as calibrated, m.
    Zero(usize),
    /// Shift of that zero since, m.
    Shift(usize),
    /// Velocity of that shift over the rate at which it reverts, m.
    ShiftVelocity(usize),
    /// Error of the reference that a channel's frames are compared with, m.
    Reference(usize),
    /// Slow error of a sensor along an axis by the first of its channels, in m of that one.
    Slow(usize),
    /// Its velocity over its angular frequency, where it is an oscillator, m.
    SlowVelocity(usize),
    /// The part of it that walks at random, m.
    SlowWalk(usize),
}

/// The states in their order, with the densities of their random walks.
#[derive(Clone, Debug)]
pub struct Layout {
    names: Vec<State>,
    walks: Vec<f64>,
    axes: usize,
}

impl Layout {
    /// The states that the settings ask for.
    pub fn new(settings: &Settings) -> Self {
        let mut layout = Self { names: Vec::new(), walks: Vec::new(), axes: settings.axes };
        for a in 0..settings.axes {
            layout.add(State::Displacement(a), 0.0);
            layout.add(State::Velocity(a), 0.0);
            layout.add(State::Bias(a), settings.bias_walk);
        }
        if settings.zero_ns.is_some() {
            for a in 0..settings.axes {
                layout.add(State::Datum(a), 0.0);
            }
        }
        for (c, channel) in settings.channels.iter().enumerate() {
            layout.add(State::Zero(c), 0.0);
            layout.add(State::Shift(c), channel.zero_walk_m2_s);
            if channel.reverting_s > 0.0 {
                layout.add(State::ShiftVelocity(c), 0.0);
            }
            layout.add(State::Reference(c), 0.0);
            if settings.slow_lead(c) == Some(c) {
                layout.add(State::Slow(c), 0.0);
                if channel.slow_hz > 0.0 {
                    layout.add(State::SlowVelocity(c), 0.0);
                }
                if channel.slow_walk_m2_s > 0.0 {
                    layout.add(State::SlowWalk(c), channel.slow_walk_m2_s);
                }
            }
        }
        layout
    }

    /// Adds a state behind the others; walk: density of its random walk, unit²/s.
    pub fn add(&mut self, name: State, walk: f64) {
        self.names.push(name);
        self.walks.push(walk);
    }

    /// How many states there are.
    pub fn size(&self) -> usize {
        self.names.len()
    }

    /// How many axes there are.
    pub fn axes(&self) -> usize {
        self.axes
    }

    /// How many of the states are the motion's.
    pub fn moving(&self) -> usize {
        MOTION_STATES * self.axes
    }

    /// The place of a state.
    pub fn place(&self, name: State) -> Option<usize> {
        self.names.iter().position(|&one| one == name)
    }

    /// The densities (n,) of the random walks.
    pub fn walks(&self) -> &[f64] {
        &self.walks
    }

    /// The states after the motion's that have a variance or walk, to `uncertain`.
    ///
    /// All others are known for certain: their covariances are 0 and stay so until a measurement changes them.
    pub fn find_uncertain(&self, p: &Matrix, uncertain: &mut Vec<usize>) {
        uncertain.clear();
        let (moving, stride) = (self.moving(), p.width() + 1);
        let variances = p.elements().iter().skip(moving * stride).step_by(stride);
        for (j, (variance, walk)) in variances.zip(&self.walks[moving..]).enumerate() {
            if *variance != 0.0 || *walk != 0.0 {
                uncertain.push(moving + j);
            }
        }
    }
}

/// The first state of an axis' motion.
pub const fn motion_of(axis: usize) -> usize {
    MOTION_STATES * axis
}
