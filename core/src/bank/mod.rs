//! A bank: the filters of all points of a group. A point's rows depend on its own readings alone.

pub mod covariance;
pub mod events;
pub mod filter;
pub mod improbable;
pub mod noise;
pub mod queue;
pub mod repeats;
pub mod rounding;
pub mod rows;
pub mod settings;

use crate::rows::Rows;
use events::{Code, Event};
use filter::{Filter, ROWS_LOST_S};
use queue::{Queue, Reading, is_hole};
use serde::{Deserialize, Serialize};
use settings::Settings;

/// This many readings of a sensor of a point wait at most.
pub const MAX_WAITING: usize = 4096;
/// An acceleration (m/s²) or displacement (m) beyond is none.
const MAX_VALUE: [f64; 2] = [1e4, 1e8];

/// Stamps (ns) and steps (ns) beyond are none.
const MAX_STAMP_NS: u64 = 1 << 62;
const MAX_STEP_NS: i64 = 1 << 47;
/// No more than this many events wait.
const MAX_EVENTS: usize = 1 << 16;

/// Which sensor of a point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sensor {
    /// m/s².
    Acceleration,
    /// m.
    Displacement,
}

/// A block of evenly timed readings.
#[derive(Clone, Copy, Debug)]
pub struct Block<'a> {
    /// Number of the point.
    pub point: u32,
    /// Stamp of the first, ns.
    pub t0_ns: i64,
    /// From one to the next, ns, positive.
    pub dt_ns: i64,
    /// The readings.
    pub values: Values<'a>,
}

/// Readings as they came.
#[derive(Clone, Copy, Debug)]
pub enum Values<'a> {
    /// Of four bytes.
    Single(&'a [f32]),
    /// Of eight.
    Double(&'a [f64]),
}

impl<'a> Values<'a> {
    /// How many there are.
    pub fn len(&self) -> usize {
        match self {
            Self::Single(values) => values.len(),
            Self::Double(values) => values.len(),
        }
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Those from one to before another.
    pub fn part(&self, first: usize, end: usize) -> Values<'a> {
        match self {
            Self::Single(values) => Self::Single(&values[first..end]),
            Self::Double(values) => Self::Double(&values[first..end]),
        }
    }
}

/// A point: its filter, and what waits.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Point {
    filter: Filter,
    samples: Queue,
    measurements: Queue,
}

/// The filters of all points.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Bank {
    settings: Settings,
    points: Vec<Point>,
    events: Vec<(u32, Event)>,
}

impl Bank {
    /// Of this many points, before their first reading.
    pub fn new(points: usize, settings: Settings) -> Self {
        let point = Point { filter: Filter::new(&settings), samples: Queue::default(), measurements: Queue::default() };
        Self { settings, points: vec![point; points], events: Vec::new() }
    }

    /// How many points there are.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// The settings.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Takes a block of a sensor of one of the points.
    pub fn push(&mut self, sensor: Sensor, block: &Block) {
        let point = &mut self.points[block.point as usize];
        let code = match block.values {
            Values::Single(values) => point.put(sensor, block, values.iter().map(|&one| f64::from(one))),
            Values::Double(values) => point.put(sensor, block, values.iter().copied()),
        };
        if let Some(code) = code
            && self.events.len() < MAX_EVENTS
        {
            self.events.push((block.point, Event { time_ns: block.t0_ns, code }));
        }
    }

    /// The rows that are complete when it is `until_ns`.
    pub fn rows(&mut self, until_ns: i64) -> Rows {
        let mut rows = Rows::default();
        rows.reserve(self.points.iter().map(|one| one.samples.len()).sum());
        let mut happened = Vec::new();
        for (number, point) in (0..).zip(&mut self.points) {
            point.run(number, until_ns, &self.settings, &mut rows, &mut happened);
            let room = MAX_EVENTS.saturating_sub(self.events.len());
            self.events.extend(happened.drain(..).take(room).map(|one| (number, one)));
        }
        rows
    }

    /// What happened since the last call.
    pub fn events(&mut self) -> Vec<(u32, Event)> {
        std::mem::take(&mut self.events)
    }
}

impl Point {
    /// Puts a block's readings into their places; what is wrong with some of them.
    fn put(&mut self, sensor: Sensor, block: &Block, values: impl Iterator<Item = f64>) -> Option<Code> {
        let (queue, after_ns, most) = match sensor {
            Sensor::Acceleration => (&mut self.samples, self.filter.sampled_ns(), MAX_VALUE[0]),
            Sensor::Displacement => (&mut self.measurements, self.filter.stamped_ns(), MAX_VALUE[1]),
        };
        let mut wrong = None;
        if block.dt_ns > MAX_STEP_NS {
            return wrong;
        }
        let mut time_ns = block.t0_ns;
        for value in values {
            if after_ns.is_some_and(|after| time_ns <= after) {
                wrong = Some(Code::Late);
            } else if value.abs() <= most
                && time_ns.unsigned_abs() < MAX_STAMP_NS
                && !queue.put(Reading { time_ns, step_ns: block.dt_ns, value }, MAX_WAITING)
                && queue.is_full(MAX_WAITING)
            {
                wrong = Some(Code::Overflow);
            }
            time_ns = time_ns.saturating_add(block.dt_ns);
        }
        wrong
    }

    fn run(&mut self, number: u32, until_ns: i64, settings: &Settings, rows: &mut Rows, happened: &mut Vec<Event>) {
        let past_ns = until_ns.saturating_sub((settings.wait_s * 1e9) as i64);
        if self.samples.is_empty() {
            // After so long without samples the filter begins anew: what was measured until then says nothing.
            let forgotten_ns = past_ns.saturating_sub((ROWS_LOST_S * 1e9) as i64);
            while self.measurements.take(forgotten_ns).is_some() {}
        }
        let mut reach_ns = None;
        while let Some(&sample) = self.samples.first() {
            let stamp = self.filter.stamp_of(sample.time_ns);
            if reach_ns.is_none_or(|reach| reach < stamp) {
                reach_ns = self.measurements.reach_ns(self.filter.stamped_ns());
            }
            let measured = reach_ns.is_some_and(|reach| reach >= stamp);
            let follows = self.filter.sampled_ns().is_none_or(|at| !is_hole(sample.time_ns - at, sample.step_ns));
            if sample.time_ns > past_ns && !(measured && follows) {
                break;
            }
            self.samples.take(sample.time_ns);
            if let Some(row) = self.filter.run(&sample, &mut self.measurements, settings, happened) {
                rows.add(number, &row, sample.step_ns, settings.rounded);
            }
        }
    }
}
