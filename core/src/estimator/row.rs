//! A measurement's row h: what each state moves it by, as data.
//!
//! Rows are built here alone; the update, the weights of the hypotheses, the steps' signatures and the smoother all
//! take them as they are, so that a sensor that measures something else is another builder.

use super::layout::{Layout, State, motion_of};
use super::motion::AxisMotion;
use super::settings::{Channel, ParameterKind, Quantity, Settings};

/// What a parameter is to a channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Effect {
    /// It does not concern the channel.
    Nothing,
    /// A relative error of its scale.
    Scale,
    /// A scale that was estimated from the accelerometer is too large by what its gain is too large: the opposite of
    /// Scale.
    Gain,
    /// The offset of its clock.
    Clock,
}

impl Effect {
    /// By which share of the displacement one unit of the parameter moves the measurement.
    pub fn sign(self) -> Option<f64> {
        match self {
            Self::Scale => Some(1.0),
            Self::Gain => Some(-1.0),
            Self::Nothing | Self::Clock => None,
        }
    }
}

/// One entry of a row: the state's place, and what one unit of it moves the measurement by.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Entry {
    /// The state's place in the layout.
    pub state: usize,
    /// Measured units per unit of the state.
    pub factor: f64,
}

/// A channel's row.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// What each state moves the measurement by.
    pub entries: Vec<Entry>,
    /// What the acceleration at the instant moves it by.
    pub input: f64,
    /// What the true velocity moves it by: the velocity state is ahead of it, see [`super::motion`].
    pub velocity: f64,
    /// The axis that it measures along.
    pub axis: usize,
    /// Measured units per metre of displacement.
    pub units_per_m: f64,
    /// What each parameter (k,) is to it.
    pub effects: Vec<Effect>,
}

impl Row {
    /// The row of a channel.
    pub fn new(c: usize, settings: &Settings, layout: &Layout) -> Self {
        let channel = &settings.channels[c];
        let (a, g, zero) = (channel.axis, channel.units_per_m, [State::Zero(c), State::Shift(c)]);
        let lead = settings.slow_lead(c).unwrap_or(c);
        let (state, factor) = match channel.measures {
            Quantity::Displacement => return Self::of_displacement(c, settings, layout),
            Quantity::Velocity => (State::Velocity(a), g),
            Quantity::Tilt => (State::Slow(lead), g),
            Quantity::TiltRate => {
                (State::SlowVelocity(lead), g * std::f64::consts::TAU * settings.channels[lead].slow_hz)
            }
        };
        let mut named = vec![(state, factor), (zero[0], g), (zero[1], g)];
        if channel.measures == Quantity::Tilt {
            named.push((State::SlowWalk(lead), g));
        }
        let places = named.into_iter().map(|(name, factor)| (layout.place(name), factor));
        let entries = places.filter_map(|(state, factor)| state.map(|state| Entry { state, factor })).collect();
        // The velocity state is ahead of the true one.
        let velocity = if channel.measures == Quantity::Velocity { g } else { 0.0 };
        let effects = vec![Effect::Nothing; settings.parameters.len()];
        Self { entries, input: 0.0, velocity, axis: a, units_per_m: g, effects }
    }

    /// The row of a channel that measures displacement, averaged over its exposure.
    fn of_displacement(c: usize, settings: &Settings, layout: &Layout) -> Self {
        let channel = &settings.channels[c];
        let (a, g, blur) = (channel.axis, channel.units_per_m, blur(channel));
        let mut entries = Vec::new();
        let mut add = |name: State, factor: f64| {
            if let Some(state) = layout.place(name) {
                entries.push(Entry { state, factor });
            }
        };
        add(State::Displacement(a), g);
        if blur != 0.0 {
            add(State::Bias(a), -g * blur);
        }
        add(State::Zero(c), g);
        add(State::Shift(c), g);
        add(State::Reference(c), g);
        if let Some(lead) = settings.slow_lead(c) {
            // What nods turns all of a picture by as many pixels.
            let units = channel.slow_units_per_m.unwrap_or(settings.channels[lead].units_per_m);
            add(State::Slow(lead), units);
            add(State::SlowWalk(lead), units);
        }
        let effects = settings.parameters.iter().map(|one| effect(one.kind, one.channels.contains(&c))).collect();
        Self { entries, input: g * blur, velocity: 0.0, axis: a, units_per_m: g, effects }
    }

    /// Σ factor · state of one column (stride `width`) of the states.
    #[inline]
    pub fn of_column(&self, x: &[f64], width: usize, column: usize) -> f64 {
        self.entries.iter().map(|one| one.factor * x[one.state * width + column]).sum()
    }

    /// Σ factor · value of a vector (n,).
    #[inline]
    pub fn of(&self, v: &[f64]) -> f64 {
        self.entries.iter().map(|one| one.factor * v[one.state]).sum()
    }

    /// What the motion's input adds to the expected measurement; acceleration: at the instant.
    #[inline]
    pub fn known(&self, motion: &AxisMotion, acceleration: f64) -> f64 {
        self.input * acceleration - self.velocity * motion.ahead()
    }

    /// The parameter that is the offset of its sensor's clock.
    pub fn clock(&self) -> Option<usize> {
        self.effects.iter().position(|&one| one == Effect::Clock)
    }

    /// The first state of its axis' motion.
    #[inline]
    pub fn motion(&self) -> usize {
        motion_of(self.axis)
    }
}

/// Second moment of the exposure about its middle, s²: displacement averaged over it is x + blur · x''.
pub fn blur(channel: &Channel) -> f64 {
    channel.exposure_s * channel.exposure_s / 24.0
}

fn effect(kind: ParameterKind, concerned: bool) -> Effect {
    match kind {
        _ if !concerned => Effect::Nothing,
        ParameterKind::ScaleError => Effect::Scale,
        ParameterKind::ClockOffset => Effect::Clock,
        ParameterKind::GainError { .. } => Effect::Gain,
    }
}
