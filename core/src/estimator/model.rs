//! What stays as it is while the filter runs, made from the settings once: layout, rows, priors.

use super::layout::{Layout, State};
use super::row::Row;
use super::settings::{NANOSECONDS, ParameterKind, Rates, Settings};
use super::slow::SlowError;

/// A channel with its row and the places of its states.
#[derive(Clone, Debug)]
pub struct ChannelModel {
    /// What each state moves its measurement by.
    pub row: Row,
    /// Whether it tells where the structure is.
    pub places: bool,
    /// Place of its zero.
    pub zero: usize,
    /// Place of the shift of its zero.
    pub shift: usize,
    /// How a shift reverts, where it does, of a variance of 0; None: a zero that has shifted stays.
    pub reverting: Option<SlowError>,
    /// Place of its reference's error.
    pub reference: usize,
    /// The slow error of its sensor; None: there is none.
    pub slow: Option<SlowError>,
    /// Variance of its zero at its first measurement, m²; None: unknown.
    pub zero_variance: Option<f64>,
    /// Number of its sensor.
    pub sensor: usize,
    /// Number of its group: all targets of a sensor along an axis step together.
    pub group: usize,
    /// Code of the kind of sensor that marks its rows.
    pub source: u8,
    /// Ages from which on its rows are coasting and lost, s.
    pub coasting_s: f64,
    /// See `coasting_s`.
    pub lost_s: f64,
    /// The parameter that is the offset of its clock; None: clocks do not step.
    pub clock: Option<usize>,
    /// Variance of the difference between two instants of the motion that are far apart, m².
    pub apart_m2: f64,
}

/// How a parameter is estimated.
#[derive(Clone, Copy, Debug)]
pub struct ParameterModel {
    /// Time from which on it is estimated, s; infinite: never.
    pub from_s: f64,
    /// Density of its walk, unit²/s.
    pub walk: f64,
    /// Least square of the sensitivity over the prediction's variance that tells it.
    pub clear: f64,
}

/// What stays as it is while the filter runs.
#[derive(Clone, Debug)]
pub struct Model {
    /// The states.
    pub layout: Layout,
    /// The channels.
    pub channels: Vec<ChannelModel>,
    /// The parameters.
    pub parameters: Vec<ParameterModel>,
    /// Of each parameter the axis whose accelerometer's gain error it is.
    pub gain_of: Vec<Option<usize>>,
    /// Places of the datums (axes,); None: rows count from the sensors' own zero.
    pub datum: Option<Vec<usize>>,
    /// How many groups of channels there are.
    pub groups: usize,
    /// How often each cause is met.
    pub rates: Rates,
    /// Measurements over which a channel's noise is followed.
    pub noise_memory: f64,
    /// Factor (axes,) on the variance of the states in rows.
    pub misfit: Vec<f64>,
    /// Variance (axes,) that nothing measured tells of a row, m².
    pub unseen_m2: Vec<f64>,
    /// Standard deviation (m) of each axis' displacement and its middle angular frequency (1/s).
    pub usual: Vec<(f64, f64)>,
    /// Acceleration (axes,) that leaning takes per metre of displacement, 1/s².
    pub lean: Vec<f64>,
}

impl Model {
    /// The model of consistent settings; `origin_ns`: what times in s count from.
    pub fn new(settings: &Settings, origin_ns: i64) -> Self {
        let layout = Layout::new(settings);
        let channels = (0..settings.channels.len()).map(|c| channel_model(c, settings, &layout)).collect();
        let sensors = settings.channels.iter().map(|one| one.sensor + 1).max().unwrap_or(0);
        let parameters = settings.parameters.iter().map(|one| ParameterModel {
            from_s: one.estimated_from_ns.map_or(f64::INFINITY, |from| since(from, origin_ns)),
            walk: one.walk,
            clear: one.clear,
        });
        let gain_of = settings.parameters.iter().map(|one| match one.kind {
            ParameterKind::GainError { axis } => Some(axis),
            ParameterKind::ScaleError | ParameterKind::ClockOffset => None,
        });
        Self {
            channels,
            parameters: parameters.collect(),
            gain_of: gain_of.collect(),
            datum: (0..settings.axes).map(|a| layout.place(State::Datum(a))).collect(),
            groups: sensors * settings.axes,
            rates: settings.rates,
            noise_memory: settings.noise_memory,
            misfit: settings.misfit[..settings.axes].to_vec(),
            unseen_m2: settings.unseen_m2[..settings.axes].to_vec(),
            usual: settings.motion[..settings.axes].to_vec(),
            lean: settings.lean[..settings.axes].to_vec(),
            layout,
        }
    }

    /// How many axes there are.
    pub fn axes(&self) -> usize {
        self.layout.axes()
    }

    /// How many states there are.
    pub fn size(&self) -> usize {
        self.layout.size()
    }

    /// Columns of the state matrix: the estimate and one sensitivity a parameter.
    pub fn columns(&self) -> usize {
        1 + self.parameters.len()
    }

    /// Whether steps of zeros are looked for.
    pub fn looks_for_steps(&self) -> bool {
        self.rates.shift > 0.0
    }
}

fn channel_model(c: usize, settings: &Settings, layout: &Layout) -> ChannelModel {
    let channel = &settings.channels[c];
    let place = |name: State| layout.place(name).unwrap_or(0);
    let (row, apart_m2) = (Row::new(c, settings, layout), settings.apart_m2(channel));
    ChannelModel {
        places: channel.places(),
        zero: place(State::Zero(c)),
        shift: place(State::Shift(c)),
        reverting: layout.place(State::ShiftVelocity(c)).map(|velocity| SlowError {
            lead: c,
            place: place(State::Shift(c)),
            velocity: Some(velocity),
            variance_m2: 0.0,
            rate_s: 1.0 / channel.reverting_s,
            omega: 1.0 / channel.reverting_s,
        }),
        reference: place(State::Reference(c)),
        slow: settings.slow_lead(c).map(|lead| {
            let first = &settings.channels[lead];
            SlowError {
                lead,
                place: place(State::Slow(lead)),
                velocity: layout.place(State::SlowVelocity(lead)),
                variance_m2: first.slow_std_m * first.slow_std_m,
                rate_s: 1.0 / first.slow_time_s,
                omega: std::f64::consts::TAU * first.slow_hz,
            }
        }),
        zero_variance: channel.zero_known().then_some(channel.zero_std_m * channel.zero_std_m),
        sensor: channel.sensor,
        group: channel.sensor * settings.axes + channel.axis,
        source: channel.source,
        coasting_s: channel.coasting_s,
        lost_s: channel.lost_s,
        clock: row.clock().filter(|&q| apart_m2 > 0.0 && settings.parameters[q].estimated_from_ns.is_some()),
        apart_m2,
        row,
    }
}

/// Seconds from an origin to an instant.
pub fn since(time_ns: i64, origin_ns: i64) -> f64 {
    time_ns.wrapping_sub(origin_ns) as f64 / NANOSECONDS
}

/// The instant this many seconds after an origin; the nearest nanosecond, halves to the even one.
pub fn instant(time_s: f64, origin_ns: i64) -> i64 {
    origin_ns.wrapping_add((time_s * NANOSECONDS).round_ties_even() as i64)
}
