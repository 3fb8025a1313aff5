//! The beginning of a stream: the state before the first sample, from the first samples and measurements, and its first
//! rows, which wait for the first measurements: these are judged by those after them.

use super::cause::Decision;
use super::decided::{Log, Undecided};
use super::innovation::Work;
use super::model::{Model, instant, since};
use super::rows::{Innovations, Output, Rows, mixed};
use super::run::{Block, Filter, Judge};
use super::samples::{INSERTED, Samples, View};
use super::settings::Settings;
use super::stream::Estimator;
use super::waiting::{Item, Timed, put_in_order};
use serde::{Deserialize, Serialize};

/// The state starts this long before the first sample, s; the same however the record is cut.
pub const START_S: f64 = 0.01;
/// The motion's first velocity lies within this many times what the sensors say of its size.
const VELOCITY_WITHIN: f64 = 3.0;
/// Acceleration is taken to belong to a motion of no less than this frequency, Hz.
const SLOWEST_HZ: f64 = 0.2;
/// Of the steps of a channel's first measurements this share is sound.
const SOUND_SHARE: f64 = 0.25;
/// The structure lies within this many times what the first measurements of the only channel scatter by.
///
/// A wider prior would make each measurement unlikely that begins it anew: of two, the farther off the first one is,
/// the more likely would the first one be.
const SCATTER_WITHIN: f64 = 3.0;
/// It lies within this many metres where the measurements are fewer than [`FEW`].
const MAX_M: f64 = 1.0;
const FEW: usize = 4;
/// Shortest time between two measurements that a speed is taken from, s.
const SHORTEST_S: f64 = 1e-3;
/// The first samples that what the acceleration was before them is taken from.
const FIRST_SAMPLES: usize = 100;

/// The state before the first sample; arrays have one element an axis.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Beginning {
    /// The first sample's time, s.
    pub time_s: f64,
    /// Its acceleration, m/s².
    pub acceleration: Vec<f64>,
    /// Displacement, m.
    pub displacement_m: Vec<f64>,
    /// Its standard deviation, m.
    pub displacement_std_m: Vec<f64>,
    /// Standard deviation of the velocity, m/s.
    pub velocity_std_m_s: Vec<f64>,
    /// How many of the first measurements are judged both ways.
    pub judged: usize,
}

impl Beginning {
    /// From the first samples, their times (s) and the first measurements, none of which may be missing.
    pub fn new(samples: View, time_s: &[f64], items: &[Timed], settings: &Settings, model: &Model) -> Self {
        let axes = settings.axes;
        let (mut place, mut within, mut speed) = (vec![0.0; axes], vec![MAX_M; axes], vec![0.0; axes]);
        for a in 0..axes {
            speed[a] = moving(deviation(&along(samples, a, samples.len())).sqrt(), settings.motion[a]);
            let channels: Vec<usize> = (0..settings.channels.len())
                .filter(|&c| settings.channels[c].axis == a && items.iter().any(|one| one.channel() == Some(c)))
                .collect();
            place[a] = first_place(items, a, model);
            for &c in &channels {
                let scatter = Scatter::of(items, c, model);
                speed[a] = scatter.speed().map_or(speed[a], |one| one.max(speed[a]));
                if channels.len() == 1 && scatter.value_m.len() >= FEW {
                    within[a] = SCATTER_WITHIN * scatter.extent_m();
                }
            }
            speed[a] *= VELOCITY_WITHIN;
            // The first measurement may come some time after the zero, from which on the state is followed.
            let first_s = items.first().map_or(time_s[0], |one| one.at_s);
            within[a] += speed[a] * (first_s - time_s[0]).max(0.0);
        }
        Self {
            time_s: time_s[0],
            acceleration: samples.value[..axes].to_vec(),
            displacement_m: place,
            displacement_std_m: settings.displacement_std_m.map_or(within, |std_m| vec![std_m; axes]),
            velocity_std_m_s: settings.velocity_std_m_s.as_ref().map_or(speed, |given| given[..axes].to_vec()),
            judged: items.len(),
        }
    }

    /// Whether it is of this many axes.
    pub fn fits(&self, axes: usize) -> bool {
        [&self.acceleration, &self.displacement_m, &self.displacement_std_m, &self.velocity_std_m_s]
            .into_iter()
            .all(|one| one.len() == axes)
    }
}

/// The first measurements of a channel.
struct Scatter {
    time_s: Vec<f64>,
    value_m: Vec<f64>,
    max_std_m: f64,
}

impl Scatter {
    fn of(items: &[Timed], c: usize, model: &Model) -> Self {
        let g = model.channels[c].row.units_per_m;
        let mut scatter = Self { time_s: Vec::new(), value_m: Vec::new(), max_std_m: 0.0 };
        for item in items {
            let Some(one) = item.item.measured().filter(|one| one.channel == c) else { continue };
            scatter.time_s.push(item.at_s);
            scatter.value_m.push(one.value / g);
            scatter.max_std_m = scatter.max_std_m.max(one.variance.sqrt() / g.abs());
        }
        scatter
    }

    /// Speed of the sound steps, m/s.
    fn speed(&self) -> Option<f64> {
        let moved = self.value_m.windows(2).map(|two| (two[1] - two[0]).abs());
        let lasting = self.time_s.windows(2).map(|two| (two[1] - two[0]).max(SHORTEST_S));
        let mut steps: Vec<f64> = moved.zip(lasting).map(|(moved, lasting)| moved / lasting).collect();
        quantile(&mut steps, SOUND_SHARE)
    }

    /// How far apart they lie, with their noise, m.
    fn extent_m(&self) -> f64 {
        let most = self.value_m.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let least = self.value_m.iter().copied().fold(f64::INFINITY, f64::min);
        most - least + self.max_std_m
    }
}

/// The median of what is measured along an axis at the instant of its first measurement, m.
fn first_place(items: &[Timed], a: usize, model: &Model) -> f64 {
    let own = |one: &Timed| one.channel().is_some_and(|c| model.channels[c].row.axis == a);
    let Some(first) = items.iter().find(|one| own(one)) else { return 0.0 };
    let same = items.iter().filter(|one| own(one) && one.at_s == first.at_s);
    let mut values: Vec<f64> = same
        .filter_map(|one| one.item.measured())
        .map(|one| one.value / model.channels[one.channel].row.units_per_m)
        .collect();
    quantile(&mut values, 0.5).unwrap_or(0.0)
}

/// Velocity (m/s) of a motion whose acceleration is `felt` (m/s²), by what is known of its standard deviation (m) and
/// middle angular frequency (1/s): its mean square is no more than those of displacement and acceleration allow.
fn moving(felt: f64, (moved, rate): (f64, f64)) -> f64 {
    if moved > 0.0 {
        (moved * (moved * rate * rate).max(felt)).sqrt()
    } else {
        felt / (std::f64::consts::TAU * SLOWEST_HZ)
    }
}

/// Puts a sample before the first one where a measurement comes before it: the zero may belong to that.
///
/// What the acceleration was until the first sample is not known: its noise is what it varies by later.
pub fn with_start(samples: View, first_s: f64, origin_ns: i64) -> Samples {
    let (start_ns, mut first_ns) = (samples.time_ns[0], instant(first_s, origin_ns));
    if first_ns >= start_ns {
        return samples.owned();
    }
    if samples.len() > 1 {
        // A whole interval at least: over nanoseconds the step to the first sample would be an endless slope.
        let mut steps: Vec<f64> = samples.time_ns.windows(2).map(|two| (two[1] - two[0]) as f64).collect();
        first_ns = first_ns.min(start_ns - quantile(&mut steps, 0.5).unwrap_or(0.0) as i64);
    }
    let mut whole = Samples::none(samples.axes);
    let count = samples.len().min(FIRST_SAMPLES);
    let mut unknown = Vec::new();
    for a in 0..samples.axes {
        let values = along(samples, a, count);
        whole.value.push(values.iter().sum::<f64>() / values.len() as f64);
        unknown.push(samples.density[a] + deviation(&values) / SLOWEST_HZ);
    }
    whole.time_ns.push(first_ns);
    whole.density.extend_from_slice(&unknown);
    whole.kind.push(INSERTED);
    whole.extend(samples);
    whole.density[samples.axes..2 * samples.axes].copy_from_slice(&unknown);
    whole
}

/// The first accelerations along an axis.
fn along(samples: View, a: usize, count: usize) -> Vec<f64> {
    samples.value.iter().skip(a).step_by(samples.axes).take(count).copied().collect()
}

/// Mean square about the mean.
fn deviation(values: &[f64]) -> f64 {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    values.iter().map(|one| (one - mean) * (one - mean)).sum::<f64>() / values.len() as f64
}

/// A quantile by straight lines between the values in their order; None of none.
fn quantile(values: &mut [f64], share: f64) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let place = share * values.len().checked_sub(1)? as f64;
    let (low, part) = (place.floor() as usize, place.fract());
    let high = values.get(low + 1).copied().unwrap_or(values[low]);
    Some(values[low] + part * (high - values[low]))
}

/// This many measurements, one of them of the sensor whose zero counts, are waited for before rows are given out.
const FIRST_MEASUREMENTS: usize = 8;
/// Or so long after the first one, s.
const FIRST_S: f64 = 2.0;
/// A zero longer before the first measurement than this (s) is not followed from there: the rows count from the latter.
const MAX_BEFORE_S: f64 = 10.0;
/// A first measurement before the first sample counts when it is no more than this (s) before it.
const BEFORE_SAMPLES_S: f64 = 2.0;

impl Estimator {
    /// Starts once enough measurements are there; until then holds the samples from before the first one on.
    pub(super) fn begin(&mut self, mut held: Samples, ended: bool, outputs: &mut Option<Output>) {
        let (origin_ns, mut time_s) = (self.origin_ns(), Vec::new());
        held.view().seconds(origin_ns, &mut time_s);
        let (Some(&sampled_s), Some(&end_s)) = (time_s.first(), time_s.last()) else { return };
        self.memory.waiting.retain(|one| one.at_s >= sampled_s - BEFORE_SAMPLES_S);
        let placed = self.placed(end_s);
        let count = placed.len();
        let first_s = placed.first().copied().unwrap_or(end_s);
        let start_s = self.start_s(first_s, sampled_s);
        let dropped = time_s.partition_point(|&one| one <= start_s).saturating_sub(1);
        held.drop_first(dropped);
        time_s.drain(..dropped);
        if count == 0 {
            self.memory.held = Some(held);
            return;
        }
        let is_enough = count >= FIRST_MEASUREMENTS && self.tells_zero(count, first_s);
        let enough = is_enough.then(|| placed[FIRST_MEASUREMENTS - 1]);
        // What the acceleration was before its first sample, the samples of some time tell.
        let until_s = if first_s >= time_s[0] {
            enough.unwrap_or(f64::INFINITY).min(first_s + FIRST_S)
        } else {
            time_s[0] + FIRST_S
        };
        let mut last = time_s.partition_point(|&one| one < until_s);
        if last >= time_s.len() {
            if !ended {
                self.memory.held = Some(held);
                return;
            }
            last = time_s.len() - 1;
        }
        let whole = held.view();
        let begun = with_start(whole.part(0, last + 1), start_s, origin_ns);
        self.start(begun.view(), first_s, outputs.get_or_insert_default());
        if last + 1 < whole.len() {
            self.run(whole.part(last + 1, whole.len()), None, outputs);
        }
    }

    /// When the filter starts, s: at the first measurement, or at the zero where that lies shortly before it, but not
    /// before the first sample: without acceleration the zero would be uncertain by decimetres.
    fn start_s(&self, first_s: f64, sampled_s: f64) -> f64 {
        let zero_s = self.settings.zero_ns.map(|zero_ns| since(zero_ns, self.origin_ns()));
        match zero_s.filter(|&zero_s| first_s - MAX_BEFORE_S <= zero_s && zero_s < first_s) {
            Some(zero_s) => zero_s.max(sampled_s.min(first_s)),
            None => first_s,
        }
    }

    /// Whether one of the first waiting measurements counts from the zero, or those that do are not waited for.
    fn tells_zero(&self, count: usize, first_s: f64) -> bool {
        let zero_s = self.settings.zero_ns.map(|zero_ns| since(zero_ns, self.origin_ns()));
        zero_s.is_none_or(|zero_s| zero_s > first_s + FIRST_S)
            || !self.settings.channels.iter().any(|channel| channel.places() && channel.zero_known())
            || self.memory.waiting.iter().filter(|one| self.is_placed(one)).take(count).any(|one| match &one.item {
                Item::Measured(row) => self.settings.channels[row.channel].zero_known(),
                _ => false,
            })
    }

    /// Whether an item is a measurement that tells where the structure is.
    fn is_placed(&self, item: &Timed) -> bool {
        item.channel().is_some_and(|c| self.settings.channels[c].places())
    }

    /// When those that wait up to an instant were measured, s.
    fn placed(&self, until_s: f64) -> Vec<f64> {
        let due = self.memory.waiting.iter().take_while(|one| one.at_s <= until_s);
        due.filter(|one| self.is_placed(one)).map(|one| one.at_s).collect()
    }

    /// Judges the first measurements, and takes the rows from a second run with what was decided.
    fn start(&mut self, samples: View, first_s: f64, output: &mut Output) {
        let origin_ns = self.origin_ns();
        self.model = Model::new(&self.settings, origin_ns);
        self.work = Work::new(&self.model);
        let mut time_s = Vec::new();
        samples.seconds(origin_ns, &mut time_s);
        let (start_s, end_s) = (time_s[0], time_s[time_s.len() - 1]);
        self.take_due(end_s);
        let mut items = std::mem::take(&mut self.items);
        // What else is measured tells nothing of where the filter starts, and the zero of a tilt from then on.
        items.retain(|one| self.is_placed(one) || one.channel().is_none() || one.at_s >= start_s);
        let placed: Vec<Timed> = items.iter().filter(|one| self.is_placed(one)).copied().collect();
        let begin = Beginning::new(samples, &time_s, &placed, &self.settings, &self.model);
        if let Some(zero_ns) = self.settings.zero_ns {
            let datum = Timed { at_s: since(zero_ns, origin_ns).max(start_s), item: Item::Datum };
            if datum.at_s <= end_s {
                items.push(datum);
                put_in_order(&mut items);
            } else {
                self.memory.waiting.push_back(datum);
                put_in_order(self.memory.waiting.make_contiguous());
            }
        }
        self.memory.first_s = first_s;
        self.one_past = true;
        let begun = Filter::begun(&begin, &self.settings, &self.model);
        self.log = self.keep_log.then(|| Log::new(begin, first_s, origin_ns, self.settings.axes));
        let (mut filter, mut undecided, count) = (begun.clone(), Undecided::default(), self.settings.channels.len());
        let first_ns = instant(first_s, origin_ns);
        let mut block = Block { samples, time_s: &time_s, items: &mut items, first_ns };
        // The innovations are those of the hypothesis that comes out as the best.
        let innovations = &mut vec![Innovations::default(); count];
        let mut open = Judge::Open { undecided: &mut undecided, innovations, origin_ns, back: None, stops: false };
        filter.run(&self.model, &mut block, &mut open, None, &mut self.work);
        if self.give_rows {
            let again = |b: usize| self.again(&begun, &mut block, &undecided.decisions_of(b));
            let runs: Vec<Rows> = (0..filter.hyps.count()).map(again).collect();
            let weights: Vec<f64> = filter.hyps.all().iter().map(|one| one.memory.weight.exp()).collect();
            output.rows = Some(mixed(&runs, &weights));
        }
        output.innovations.resize_with(count, Innovations::default);
        let best = undecided.best();
        for one in [&undecided.settled, &best] {
            for ((item, evidence), &decision) in one.items.iter().zip(&one.evidence).zip(&one.decisions) {
                let Some(c) = item.channel() else { continue };
                let units_per_m = self.model.channels[c].row.units_per_m;
                output.innovations[c].push(instant(item.at_s, origin_ns), units_per_m, evidence, decision);
            }
        }
        self.memory.filter = Some(filter);
        self.memory.undecided = undecided;
        self.settle(samples, output);
    }

    /// The rows of the first samples with what one hypothesis decided.
    fn again(&mut self, begun: &Filter, block: &mut Block, decisions: &[Decision]) -> Rows {
        let mut rows = Rows::default();
        let mut judge = Judge::Decided { decisions, back: None };
        begun.clone().run(&self.model, block, &mut judge, Some(&mut rows), &mut self.work);
        rows
    }
}
