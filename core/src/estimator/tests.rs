//! The filter and the smoother against plain matrices, and a state and a channel that neither knows.

use super::cause::{Cause, Decision, Pace, Prior};
use super::decided::Decided;
use super::hypothesis::Hypothesis;
use super::innovation::{Scene, Work, meet_zero};
use super::layout::State;
use super::matrix::Matrix;
use super::model::Model;
use super::motion::AxisMotion;
use super::predict::predict_covariance;
use super::rows::Rows;
use super::run::{Block, Filter, Judge};
use super::samples::Samples;
use super::settings::{Channel, Quantity, Rates, Settings};
use super::smoother::{Adjoint, Counted, Counting};
use super::start::Beginning;
use super::waiting::{Item, Measurement, Timed};
use super::way_back::WayBack;

/// A channel that measures metres.
pub fn channel() -> Channel {
    Channel {
        sensor: 0,
        measures: Quantity::Displacement,
        tilt_of: 0,
        slow_units_per_m: None,
        source: 1,
        units_per_m: 1.0,
        axis: 0,
        variance_factor: 1.0,
        exposure_s: 0.0,
        zero_std_m: 0.0,
        zero_walk_m2_s: 0.0,
        coasting_s: 0.4,
        lost_s: 10.0,
        slow_std_m: 0.0,
        slow_time_s: f64::INFINITY,
        slow_hz: 0.0,
        slow_walk_m2_s: 0.0,
        reverting_s: 0.0,
    }
}

/// One an hour of each.
pub fn rates() -> Rates {
    let hour = 1.0 / 3600.0;
    Rates {
        outlier: 0.01,
        stays: 0.6,
        shift: hour,
        revert: 0.5,
        back: 0.1,
        wrong: hour,
        noise: hour,
        lost: hour,
        clock: hour,
        odds: 12.0,
    }
}

/// Nothing is ever wrong.
pub fn no_errors() -> Rates {
    let none = 0.0;
    Rates {
        outlier: none,
        stays: none,
        shift: none,
        revert: none,
        back: none,
        wrong: none,
        noise: none,
        lost: none,
        clock: none,
        odds: 12.0,
    }
}

/// The settings of one axis with these channels.
pub fn settings(channels: Vec<Channel>, rates: Rates) -> Settings {
    Settings {
        channels,
        axes: 1,
        parameters: Vec::new(),
        bias_m_s2: vec![0.0],
        bias_std_m_s2: vec![0.2],
        bias_walk: 0.0,
        velocity_std_m_s: Some(vec![0.5]),
        displacement_std_m: Some(0.3),
        rates,
        noise_memory: f64::INFINITY,
        noise_weight: 1e30,
        motion: vec![(0.0, 0.0)],
        zero_ns: None,
        unseen_m2: vec![0.0],
        unseen_common_m2: vec![0.0],
        misfit: vec![1.0],
        lean: vec![0.0],
    }
}

/// A beginning with these standard deviations.
pub fn beginning(displacement_std: f64, velocity_std: f64) -> Beginning {
    Beginning {
        time_s: 0.0,
        acceleration: vec![0.0],
        displacement_m: vec![0.0],
        displacement_std_m: vec![displacement_std],
        velocity_std_m_s: vec![velocity_std],
        judged: 0,
    }
}

/// A measurement of a channel.
pub fn measured(at_s: f64, channel: usize, value: f64, variance: f64) -> Timed {
    Timed { at_s, item: Item::Measured(Measurement { channel, value, variance, reference: 0.0 }) }
}

/// A matrix product.
fn times(a: &Matrix, b: &Matrix) -> Matrix {
    let mut out = Matrix::zeros(a.height(), b.width());
    for i in 0..a.height() {
        for j in 0..b.width() {
            out[(i, j)] = (0..b.height()).map(|k| a[(i, k)] * b[(k, j)]).sum();
        }
    }
    out
}

fn transposed(a: &Matrix) -> Matrix {
    let mut out = Matrix::zeros(a.width(), a.height());
    for i in 0..a.height() {
        for j in 0..a.width() {
            out[(j, i)] = a[(i, j)];
        }
    }
    out
}

/// Numbers that look like none, the same each time.
struct Scatter(u64);

impl Scatter {
    /// Between -1 and 1.
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }
}

fn close(one: &Matrix, other: &Matrix, relative: f64) -> bool {
    let size = one.elements().iter().fold(0.0f64, |most, value| most.max(value.abs()));
    one.elements().iter().zip(other.elements()).all(|(a, b)| (a - b).abs() <= relative * size)
}

#[test]
fn the_covariance_is_predicted_as_by_whole_matrices() {
    for axes in [1, 2] {
        let mut set = settings(vec![channel(), channel()], rates());
        (set.axes, set.bias_walk) = (axes, 1e-3);
        set.channels[1].zero_walk_m2_s = 2e-3;
        let model = Model::new(&Settings { bias_m_s2: vec![0.0; 2], ..set.clone() }.with_axes(axes), 0);
        let (n, moving, dt) = (model.size(), model.layout.moving(), 0.013);
        let (mut scatter, mut root) = (Scatter(axes as u64), Matrix::zeros(n, n));
        // Of the others, the first and the last are certain; the last one's walk does not let it stay so.
        for i in (0..n).filter(|&i| i != moving && i != n - 2) {
            root.row_mut(i).iter_mut().for_each(|value| *value = scatter.next());
        }
        let mut p = times(&root, &transposed(&root));
        let mut transition = Matrix::diagonal(&vec![1.0; n]);
        for i in (0..moving).step_by(3) {
            (transition[(i, i + 1)], transition[(i, i + 2)], transition[(i + 1, i + 2)]) = (dt, -0.5 * dt * dt, -dt);
        }
        let mut expected = times(&times(&transition, &p), &transposed(&transition));
        for j in 0..n {
            expected[(j, j)] += dt * model.layout.walks()[j];
        }
        let mut uncertain = Vec::new();
        model.layout.find_uncertain(&p, &mut uncertain);
        assert!(!uncertain.contains(&moving) && uncertain.contains(&(n - 2)));
        predict_covariance(&mut p, &model.layout, dt, &uncertain, &[]);
        // Sums of a dozen products of size 10.
        assert!(close(&p, &expected, 1e-13) && p == transposed(&p));
    }
}

impl Settings {
    fn with_axes(mut self, axes: usize) -> Self {
        self.axes = axes;
        for one in [&mut self.bias_m_s2, &mut self.bias_std_m_s2, &mut self.unseen_m2, &mut self.unseen_common_m2] {
            one.resize(axes, 0.0);
        }
        self.misfit.resize(axes, 1.0);
        self.lean.resize(axes, 0.0);
        self.motion.resize(axes, (0.0, 0.0));
        self
    }
}

/// A filter of plain matrices.
struct Plain {
    x: Matrix,
    p: Matrix,
}

impl Plain {
    fn predict(&mut self, transition: &Matrix, noise: &Matrix, moved: &[f64]) {
        self.x = times(transition, &self.x);
        for (j, value) in moved.iter().enumerate() {
            self.x[(j, 0)] += value;
        }
        self.p = times(&times(transition, &self.p), &transposed(transition));
        for (own, more) in self.p.elements_mut().iter_mut().zip(noise.elements()) {
            *own += more;
        }
    }

    fn update(&mut self, h: &Matrix, innovation: f64, variance: f64) {
        let ph = times(&self.p, &transposed(h));
        let total = times(h, &ph)[(0, 0)] + variance;
        let php = times(&ph, &transposed(&ph));
        for (own, less) in self.p.elements_mut().iter_mut().zip(php.elements()) {
            *own -= less / total;
        }
        for j in 0..self.x.height() {
            self.x[(j, 0)] += ph[(j, 0)] * innovation / total;
        }
    }
}

/// A camera that tilts, with an inclinometer and a gyroscope on its box and a vibrometer on the beam: all measured as the
/// filter takes them, against matrices that are written down here.
#[test]
fn velocity_tilt_and_its_rate_are_a_row_each() {
    let (lever, hz, decay_s, tilt_std) = (7.0, 0.8, 0.3, 2e-3);
    let of = |measures: Quantity, units_per_m: f64| Channel { sensor: 1, measures, units_per_m, ..channel() };
    let camera = Channel { slow_std_m: tilt_std, slow_time_s: decay_s, slow_hz: hz, units_per_m: lever, ..channel() };
    let set = settings(
        vec![
            camera,
            Channel { zero_std_m: 0.05, ..of(Quantity::Velocity, -2.0) },
            Channel { zero_std_m: 0.04, zero_walk_m2_s: 1e-6, ..of(Quantity::TiltRate, 0.7) },
            Channel { zero_std_m: 0.01, ..of(Quantity::Tilt, 0.6) },
        ],
        no_errors(),
    );
    let model = Model::new(&set, 0);
    let at = |name: State| model.layout.place(name).unwrap();
    let (tilt, rate) = (at(State::Slow(0)), at(State::SlowVelocity(0)));
    let zeros: Vec<usize> = (1..4).map(|c| at(State::Zero(c))).collect();
    let shift = at(State::Shift(2));
    let mut scatter = Scatter(5);
    let mut items: Vec<Timed> =
        (0..90).map(|k| measured(0.033 + 0.021 * f64::from(k), (k % 4) as usize, scatter.next(), 1e-4)).collect();
    let (_, filter, _, _) = run(&model, &set, &mut items);
    let n = model.size();
    let mut plain = Plain { x: Matrix::zeros(n, 1), p: Matrix::zeros(n, n) };
    for (j, std) in [(0, 0.3), (1, 0.5), (2, 0.2), (tilt, tilt_std), (rate, tilt_std)] {
        plain.p[(j, j)] = std * std;
    }
    for (&j, std) in zeros.iter().zip([0.05, 0.04, 0.01]) {
        plain.p[(j, j)] = std * std;
    }
    // The filter begins a hundredth of a second before the first sample.
    plain.p[(shift, shift)] = 1e-6 * 0.01;
    let omega = std::f64::consts::TAU * hz;
    // Samples every 10 ms, of which each interval is cut at the measurements in it.
    let (mut place, density, step) = (0, 1e-5, 0.01);
    for k in 0..199 {
        let (from, until) = (step * f64::from(k), step * f64::from(k + 1));
        let (input, next) = ((0.1 * f64::from(k)).sin(), (0.1 * f64::from(k + 1)).sin());
        let (slope, mut now) = ((next - input) / step, from);
        let own = |t: f64| (input + slope * (t - from), slope);
        let go = |plain: &mut Plain, to: f64, now: &mut f64| {
            let dt = to - *now;
            if dt <= 0.0 {
                return;
            }
            let mut transition = Matrix::diagonal(&vec![1.0; n]);
            (transition[(0, 1)], transition[(0, 2)], transition[(1, 2)]) = (dt, -0.5 * dt * dt, -dt);
            let turned = super::slow::Turn::over(dt, 1.0 / decay_s, omega);
            let (first, second) = (turned.of(1.0, 0.0), turned.of(0.0, 1.0));
            (transition[(tilt, tilt)], transition[(rate, tilt)]) = first;
            (transition[(tilt, rate)], transition[(rate, rate)]) = second;
            let mut noise = Matrix::zeros(n, n);
            noise[(0, 0)] = density * dt * dt * dt / 3.0;
            noise.set_both(0, 1, 0.5 * density * dt * dt);
            noise[(1, 1)] = density * dt;
            noise[(shift, shift)] = 1e-6 * dt;
            let added = turned.added().map(|one| one * tilt_std * tilt_std);
            (noise[(tilt, tilt)], noise[(rate, rate)]) = (added[0], added[2]);
            noise.set_both(tilt, rate, added[1]);
            let (a, slope) = own(*now);
            plain.predict(&transition, &noise, &[dt * dt * (0.5 * a + slope * dt / 6.0), dt * (a + 0.5 * slope * dt)]);
            *now = to;
        };
        while place < items.len() && items[place].at_s <= until {
            let Some(one) = items[place].item.measured() else { break };
            go(&mut plain, items[place].at_s, &mut now);
            let mut h = Matrix::zeros(1, n);
            match one.channel {
                0 => (h[(0, 0)], h[(0, tilt)]) = (lever, lever),
                1 => (h[(0, 1)], h[(0, zeros[0])]) = (-2.0, -2.0),
                2 => (h[(0, rate)], h[(0, zeros[1])], h[(0, shift)]) = (0.7 * omega, 0.7, 0.7),
                _ => (h[(0, tilt)], h[(0, zeros[2])]) = (0.6, 0.6),
            }
            let e = one.value - times(&h, &plain.x)[(0, 0)];
            plain.update(&h, e, one.variance);
            place += 1;
        }
        go(&mut plain, until, &mut now);
    }
    let best = filter.hyps.best();
    // The filter's velocity is ahead of the true one, and its slow error is carried to its last measurement only. Its
    // input is of fourth order, of straight lines here: a hundredth of a standard deviation.
    for j in (0..n).filter(|&j| ![1, tilt, rate].contains(&j)) {
        assert!((best.x[(j, 0)] - plain.x[(j, 0)]).abs() <= 1e-2 * plain.p[(j, j)].sqrt());
        assert!((best.p[(j, j)] - plain.p[(j, j)]).abs() <= 1e-6 * plain.p[(j, j)]);
    }
}

/// Samples without acceleration and measurements between them, taken as good; rows and what the way back needs.
fn run(model: &Model, settings: &Settings, items: &mut [Timed]) -> (Filter, Filter, Rows, WayBack) {
    let decisions = vec![Decision::GOOD; items.len()];
    run_decided(model, settings, items, &decisions)
}

/// The same, taken as was decided.
fn run_decided(
    model: &Model,
    settings: &Settings,
    items: &mut [Timed],
    decisions: &[Decision],
) -> (Filter, Filter, Rows, WayBack) {
    let mut samples = Samples::none(1);
    for k in 0..200i64 {
        samples.time_ns.push(10_000_000 * k);
        samples.value.push((0.1 * k as f64).sin());
        samples.density.push(1e-5);
        samples.kind.push(0);
    }
    let mut time_s = Vec::new();
    samples.view().seconds(0, &mut time_s);
    let before = Filter::begun(&beginning(0.3, 0.5), settings, model);
    let (mut filter, mut rows, mut way) = (before.clone(), Rows::default(), WayBack::default());
    way.restart(model, before.clock.time_s);
    let mut block = Block { samples: samples.view(), time_s: &time_s, items, first_ns: 0 };
    let mut judge = Judge::Decided { decisions, back: Some(&mut way) };
    filter.run(model, &mut block, &mut judge, Some(&mut rows), &mut Work::new(model));
    (before, filter, rows, way)
}

#[test]
fn the_last_smoothed_row_is_the_filters_and_none_is_less_certain() {
    let set = settings(vec![channel()], no_errors());
    let model = Model::new(&set, 0);
    let mut items: Vec<Timed> =
        (0..40).map(|k| measured(0.03 + 0.047 * f64::from(k), 0, 1e-3 * f64::from(k % 5), 1e-6)).collect();
    let (before, last, rows, way) = run(&model, &set, &mut items);
    let decided = Decided { decisions: vec![Decision::GOOD; items.len()], evidence: Vec::new(), items };
    let counting = Counting::new(&model, before.hyps.best(), &[&decided]);
    let view = Counted { model: &model, counting: &counting, last: last.hyps.best() };
    let (mut adjoint, mut found) = (Adjoint::nothing(&model), Vec::new());
    adjoint.pass(&way, &view, 0..200, &mut found);
    let own = &rows.axes[0];
    assert_eq!(found.len(), 200);
    let end = found[199];
    assert!((end.value - own.displacement[199]).abs() < 1e-12 && (end.velocity - own.velocity[199]).abs() < 1e-12);
    for (one, &filtered) in found.iter().zip(&own.variance) {
        assert!(one.variance <= filtered * (1.0 + 1e-9) && one.variance > 0.0);
    }
    // The same without rows: what is carried to the beginning is the same.
    let mut other = Adjoint::nothing(&model);
    other.pass(&way, &view, 0..0, &mut found);
    assert!(found.is_empty() && close(&adjoint.rows(), &other.rows(), 1e-9));
}

/// A shift reverts from one measurement to another where it is gone: meanwhile the band of the filter opens, and the
/// smoother closes it again by what comes after.
#[test]
fn a_shift_that_reverts_opens_the_band_until_it_is_gone() {
    let set = settings(vec![Channel { reverting_s: 0.2, ..channel() }], no_errors());
    let model = Model::new(&set, 0);
    let (shift, size) = (model.channels[0].shift, 0.05);
    let off = |k: i32| if (10..30).contains(&k) { size } else { 0.0 };
    let mut items: Vec<Timed> = (0..40).map(|k| measured(0.03 + 0.047 * f64::from(k), 0, off(k), 1e-6)).collect();
    let mut decisions = vec![Decision::GOOD; items.len()];
    decisions[10] = Decision::of(Cause::Shift(Prior::Reverting(Pace::Slow)));
    decisions[30] = Decision::of(Cause::Shift(Prior::FormerZero));
    let (before, last, rows, way) = run_decided(&model, &set, &mut items, &decisions);
    // Samples at 0.49 s, before the shift, at 1.43 s, before it is gone, and after.
    let filtered = &rows.axes[0].variance;
    assert!(filtered[142] > 100.0 * filtered[48] && filtered[150] < 2.0 * filtered[48]);
    let best = last.hyps.best();
    assert!(best.x[(shift, 0)] == 0.0 && best.p[(shift, shift)] == 0.0 && best.marks[0].reverting_m2 == 0.0);
    let decided = Decided { decisions, evidence: Vec::new(), items };
    let counting = Counting::new(&model, before.hyps.best(), &[&decided]);
    let view = Counted { model: &model, counting: &counting, last: best };
    let mut smoothed = Vec::new();
    Adjoint::nothing(&model).pass(&way, &view, 0..way.len(), &mut smoothed);
    for (one, &own) in smoothed.iter().zip(filtered) {
        assert!(one.variance <= own * (1.0 + 1e-9) && one.variance > 0.0);
    }
    assert!(smoothed[142].variance < 0.1 * filtered[142]);
    // What it carries is worth as much as was measured: long after it lies as wide as it was large, before anything
    // more is measured.
    let mut alone = before.hyps.best().clone();
    (alone.marks[0].reverting_m2, alone.p[(shift, shift)]) = (size * size, 0.0);
    let (row, motion) =
        (Measurement { channel: 0, value: 0.0, variance: 1e-6, reference: 0.0 }, [AxisMotion::default()]);
    let scene = Scene {
        model: &model,
        row: &row,
        channel: &model.channels[0],
        at_s: 10.0,
        motion: &motion,
        acceleration: 0.0,
        density: 0.0,
    };
    meet_zero(&mut alone, &scene);
    assert!((alone.p[(shift, shift)] / (size * size) - 1.0).abs() < 1e-6);
}

#[test]
fn certain_states_may_be_left_out_on_the_way_back() {
    let set = settings(vec![channel(), channel()], no_errors());
    let model = Model::new(&set, 0);
    let mut items: Vec<Timed> = (0..40)
        .map(|k| measured(0.03 + 0.047 * f64::from(k), (k % 2) as usize, 1e-3 * f64::from(k % 5), 1e-6))
        .collect();
    let (before, last, _, mut way) = run(&model, &set, &mut items);
    let decided = Decided { decisions: vec![Decision::GOOD; items.len()], evidence: Vec::new(), items };
    let counting = Counting::new(&model, before.hyps.best(), &[&decided]);
    let view = Counted { model: &model, counting: &counting, last: last.hyps.best() };
    let (mut quick, mut whole) = (Vec::new(), Vec::new());
    Adjoint::nothing(&model).pass(&way, &view, 0..way.len(), &mut quick);
    let all: Vec<usize> = (0..model.size()).collect();
    way.note_uncertain(&all);
    Adjoint::nothing(&model).pass(&way, &view, 0..way.len(), &mut whole);
    for (one, other) in quick.iter().zip(&whole) {
        // Rounding: W is rotated to another number of columns.
        assert!((one.value - other.value).abs() < 1e-6 * other.variance.sqrt());
        assert!((one.variance / other.variance - 1.0).abs() < 1e-6);
    }
}

#[test]
fn a_hypothesis_of_another_shape_does_not_fit() {
    let (one, two) = (settings(vec![channel()], rates()), settings(vec![channel(), channel()], rates()));
    let (of_one, of_two) = (Model::new(&one, 0), Model::new(&two, 0));
    let hyp = Hypothesis::begun(&beginning(0.1, 0.1), &one, &of_one);
    assert!(hyp.fits(&of_one) && !hyp.fits(&of_two));
}
