//! The one loop of the estimator over a block of samples and measurements.
//!
//! Measurements are either judged as they come, by hypotheses (see [`super::hypotheses`]), or taken as was decided
//! before: then one hypothesis is enough, and what the pass back ([`super::smoother`]) needs can be left.

use super::acceptance::{accept, find_step};
use super::cause::{Cause, Decision, VAGUE, apply};
use super::clock_bank::MAX_OFFSET_NS;
use super::coast::Leave;
use super::decided::{Survivor, Undecided};
use super::hypotheses::Hypotheses;
use super::hypothesis::Hypothesis;
use super::innovation::{Innovation, Scene, Work, is_back, look, meet_zero};
use super::layout::motion_of;
use super::model::{Model, instant};
use super::motion::{AxisMotion, Clock, Way, shift_velocity};
use super::predict::{add_noise, predict_covariance, predict_mean};
use super::rows::{Innovations, Rows};
use super::samples::View;
use super::settings::{MAX_AXES, Settings};
use super::situation::{GATE, log_normal, log_wrong};
use super::slow::Turn;
use super::start::{Beginning, START_S};
use super::steps::SURE;
use super::suspicion::Watch;
use super::update::{move_motion, relinearise, renew_parameter, set_datum};
use super::waiting::{Item, Measurement, Timed};
use super::way_back::{Scaled, WayBack};
use serde::{Deserialize, Serialize};

/// The hypotheses, the motion's input and the clock, that a run changes and carries on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Filter {
    /// The hypotheses.
    pub hyps: Hypotheses,
    /// The input along each axis.
    pub motion: Vec<AxisMotion>,
    /// The times.
    pub clock: Clock,
    /// How many of the next measurements are judged both ways.
    pub judged: usize,
    /// How well measurements agree with the sensors' clocks.
    pub watch: Watch,
}

/// Stamps that went back may have stepped by this, s: what a bank of offsets covers.
const WENT_BACK_S: f64 = 1e-9 * MAX_OFFSET_NS as f64;

/// A block to run over.
pub struct Block<'a> {
    /// Its samples, all after the filter's time.
    pub samples: View<'a>,
    /// Their times, s.
    pub time_s: &'a [f64],
    /// The items within them, in time order; those of one instant are put in the order they are taken in.
    pub items: &'a mut [Timed],
    /// The stamp of the first row, ns.
    pub first_ns: i64,
}

/// What a run does with measurements, and what it leaves of them.
pub enum Judge<'a> {
    /// Nothing is decided: the hypotheses judge.
    Open {
        /// What each hypothesis took each item for.
        undecided: &'a mut Undecided,
        /// How the best one met them, of each channel.
        innovations: &'a mut [Innovations],
        /// What times in s count from, ns.
        origin_ns: i64,
        /// What the way back needs, as long as one hypothesis takes all as good.
        back: Option<&'a mut WayBack>,
        /// Whether the run ends behind the first sample up to which a clock is suspected to have stepped.
        stops: bool,
    },
    /// One hypothesis takes what it finds likely and leaves out what it does not.
    Alone(&'a mut Alone),
    /// All is decided.
    Decided {
        /// What each item is taken for.
        decisions: &'a [Decision],
        /// What the way back needs, where there is one.
        back: Option<&'a mut WayBack>,
    },
}

impl Judge<'_> {
    /// What the way back needs.
    fn back(&mut self) -> Option<&mut WayBack> {
        match self {
            Self::Open { back, .. } | Self::Decided { back, .. } => back.as_deref_mut(),
            Self::Alone(_) => None,
        }
    }
}

/// What a hypothesis alone made of measurements.
#[derive(Clone, Debug, Default)]
pub struct Alone {
    /// Of each item whether its likelihood counts and it is not taken; none: all are.
    pub untaken: Vec<bool>,
    /// Logarithm of the likelihood of all measurements.
    pub log_likelihood: f64,
    /// What each was taken for.
    pub undecided: Undecided,
}

/// A measurement's place in its interval.
#[derive(Clone, Copy)]
struct Place<'a> {
    /// Time from the interval's start, s.
    since_s: f64,
    /// The interval's length, s.
    dt: f64,
    /// The accelerations at its end.
    end: &'a [f64],
    /// The densities of their noise.
    density: &'a [f64],
}

impl Filter {
    /// Before its first sample.
    pub fn begun(begin: &Beginning, settings: &Settings, model: &Model) -> Self {
        Self {
            hyps: Hypotheses::one(Hypothesis::begun(begin, settings, model)),
            motion: begin.acceleration.iter().map(|&input| AxisMotion { input, ..AxisMotion::default() }).collect(),
            clock: Clock { time_s: begin.time_s - START_S, step_s: f64::INFINITY },
            judged: begin.judged,
            watch: Watch::new(settings.channels.len()),
        }
    }

    /// A copy with the best hypothesis alone.
    pub fn best_alone(&self) -> Self {
        let hyps = Hypotheses::one(self.hyps.best().clone());
        Self { hyps, motion: self.motion.clone(), clock: self.clock, judged: self.judged, watch: self.watch.clone() }
    }

    /// Becomes a copy of the best hypothesis of another one of the same model, in the memory that it has.
    pub fn copy_best(&mut self, other: &Self) {
        self.hyps.set_one(other.hyps.best());
        self.motion.clone_from(&other.motion);
        self.watch.clone_from(&other.watch);
        (self.clock, self.judged) = (other.clock, other.judged);
    }

    /// Whether it is where another one is that has one hypothesis alone.
    pub fn is_at(&self, other: &Self) -> bool {
        let same = self.hyps.best().is_at(other.hyps.best());
        same && other.hyps.count() == 1
            && (&self.motion, self.clock, self.judged) == (&other.motion, other.clock, other.judged)
    }

    /// Whether it is of the model's shape.
    pub fn fits(&self, model: &Model) -> bool {
        self.hyps.fit(model) && self.motion.len() == model.axes() && self.watch.fits(model.channels.len())
    }

    /// Runs over a block; rows: where they are to go. Returns how many samples it has run over.
    pub fn run(
        &mut self,
        model: &Model,
        block: &mut Block,
        judge: &mut Judge,
        mut rows: Option<&mut Rows>,
        work: &mut Work,
    ) -> usize {
        self.note_uncertain(model, judge, work);
        let (mut next, mut ordered, mut k) = (0, 0, 0);
        while k < block.time_s.len() {
            if self.hyps.count() == 1 {
                let before_s = block.items.get(next).map_or(f64::INFINITY, |item| item.at_s);
                let leave = &mut Leave { rows: rows.as_deref_mut(), back: judge.back(), ahead_s: &[] };
                let reached = self.coast(model, block, (k, before_s), leave, work);
                if reached > k {
                    k = reached;
                    continue;
                }
            }
            self.step(model, block, (k, &mut next, &mut ordered), judge, work);
            let leave = &mut Leave { rows: rows.as_deref_mut(), back: judge.back(), ahead_s: &[] };
            self.leave_sample(model, (block, k), leave, work);
            k += 1;
            if matches!(judge, Judge::Open { stops: true, .. }) && self.watch.suspect.is_some() {
                break;
            }
        }
        k
    }

    /// Goes on over the interval that ends at a sample, with the items in it.
    fn step(
        &mut self,
        model: &Model,
        block: &mut Block,
        (k, next, ordered): (usize, &mut usize, &mut usize),
        judge: &mut Judge,
        work: &mut Work,
    ) {
        let (axes, begun_s, end_s) = (model.axes(), self.clock.time_s, block.time_s[k]);
        let (dt, gap, step_s) = (end_s - begun_s, self.clock.is_gap(end_s), self.clock.step_s);
        let density = &block.samples.density[k * axes..(k + 1) * axes];
        let mut now = [0.0; MAX_AXES];
        self.leaned(model, &block.samples.value[k * axes..(k + 1) * axes], dt, &mut now);
        self.begin_interval(model, &now, end_s);
        let mut reached = 0.0;
        while let Some(item) = block.items.get(*next).filter(|item| item.at_s <= end_s) {
            let since_s = item.at_s - begun_s;
            if since_s > reached {
                self.advance(model, reached, since_s, density, work);
                reached = since_s;
            }
            let place = Place { since_s, dt, end: &now, density };
            self.meet(model, (block.items, *next, ordered), &place, judge, work);
            self.note_uncertain(model, judge, work);
            *next += 1;
        }
        if dt > reached {
            self.advance(model, reached, dt, density, work);
        }
        self.clock.advance(end_s);
        if gap {
            self.watch.doubt_all(dt - step_s);
        }
        for (axis, &input) in self.motion.iter_mut().zip(&now) {
            axis.input = input;
        }
        // What is open must not grow with the time in which nothing tells hypotheses apart.
        self.hyps.end_where_lost(end_s, model);
    }

    /// Finds the uncertain states of the best hypothesis.
    fn note_uncertain(&self, model: &Model, judge: &mut Judge, work: &mut Work) {
        model.layout.find_uncertain(&self.hyps.best().p, &mut work.uncertain);
        if let Some(back) = judge.back() {
            back.note_uncertain(&work.uncertain);
        }
    }

    /// The accelerations of a sample, with what leaning takes added: an error of the displacement makes that times it
    /// of the acceleration, far below its noise.
    #[inline]
    fn leaned(&self, model: &Model, value: &[f64], dt: f64, now: &mut [f64; MAX_AXES]) {
        let x = &self.hyps.best().x;
        for (a, (out, &one)) in now.iter_mut().zip(value).enumerate() {
            let i = motion_of(a);
            *out = one + model.lean[a] * (x[(i, 0)] + dt * x[(i + 1, 0)]);
        }
    }

    /// Brings the velocity states of all axes to the interval that ends at `end_s`.
    fn begin_interval(&mut self, model: &Model, now: &[f64], end_s: f64) {
        let (dt, lead) = (end_s - self.clock.time_s, self.clock.lead(end_s));
        for (a, axis) in self.motion.iter_mut().enumerate() {
            let moved = axis.begin(now[a], dt, lead);
            if moved != 0.0 {
                for hyp in self.hyps.all_mut() {
                    shift_velocity(&mut hyp.x, a, moved, &model.gain_of);
                }
            }
        }
    }

    /// Moves all hypotheses within the interval.
    #[inline]
    fn advance(&mut self, model: &Model, from_s: f64, until_s: f64, density: &[f64], work: &mut Work) {
        let way = Way::new(&self.motion, from_s, until_s);
        for (b, hyp) in self.hyps.all_mut().iter_mut().enumerate() {
            let uncertain = if b == 0 {
                &work.uncertain
            } else {
                model.layout.find_uncertain(&hyp.p, &mut work.others);
                &work.others
            };
            predict_mean(&mut hyp.x, model.axes(), &way, &model.gain_of);
            predict_covariance(&mut hyp.p, &model.layout, way.dt, uncertain, density);
            if let Some(burst) = hyp.memory.burst {
                add_noise(&mut hyp.p, burst.axis, way.dt, burst.density);
            }
        }
    }

    /// Takes the item at place `j`, judged or as decided; ordered: up to where items of one instant are in their order.
    fn meet(
        &mut self,
        model: &Model,
        (items, j, ordered): (&mut [Timed], usize, &mut usize),
        place: &Place,
        judge: &mut Judge,
        work: &mut Work,
    ) {
        let Item::Measured(_) = items[j].item else { return self.pass_mark(model, items[j], judge) };
        let open = matches!(judge, Judge::Open { .. });
        if open && j >= *ordered && items.get(j + 1).is_some_and(|one| one.at_s == items[j].at_s) {
            *ordered = self.order_frame(model, items, j, place, work);
        }
        let Timed { at_s, item: Item::Measured(row) } = items[j] else { return };
        let Self { hyps, motion, judged, watch, .. } = self;
        let scene = scene_of(model, motion, &row, at_s, place);
        if *judged == 0 {
            watch.end_lapse();
        }
        match judge {
            Judge::Open { undecided, innovations, origin_ns, back, .. } => {
                let left = judge_open((hyps, judged, watch), &scene, back.as_deref_mut(), work);
                *back = if left { back.take() } else { None };
                let best = &hyps.best().memory;
                let time_ns = instant(at_s, *origin_ns);
                innovations[row.channel].push(time_ns, scene.channel.row.units_per_m, &best.met, best.decision);
                undecided.add(items[j], hyps.all().iter().map(Survivor::of));
            }
            Judge::Decided { decisions, back } => {
                let decision = decisions.get(j).copied().unwrap_or(Decision::GOOD);
                take_decided(hyps.best_mut(), decision, &scene, back.as_deref_mut(), work);
                if *judged > 0 {
                    pass_first(hyps, judged, &scene);
                }
            }
            Judge::Alone(alone) => take_alone(hyps.best_mut(), alone, &scene, (j, items[j]), work),
        }
    }

    /// The rows count from here, clocks are in doubt, or one has stepped; each hypothesis goes on as it is.
    fn pass_mark(&mut self, model: &Model, mark: Timed, judge: &mut Judge) {
        for hyp in self.hyps.all_mut() {
            if mark.item == Item::Datum {
                set_datum(&mut hyp.x, &mut hyp.p, &model.layout);
                hyp.clear_tests();
            }
        }
        if mark.item == Item::WentBack {
            self.watch.doubt_all(WENT_BACK_S);
        }
        if let Judge::Decided { back: Some(back), .. } = judge {
            back.pass_mark(mark, &self.hyps.best().parameters);
        }
        if let Item::Relinearised { parameter, by_s } = mark.item {
            self.hyps.all_mut().iter_mut().for_each(|hyp| relinearise(hyp, parameter, by_s));
        }
        if let Item::ClockStep { parameter, variance, moved_s } = mark.item {
            for hyp in self.hyps.all_mut() {
                renew_parameter(hyp, parameter, variance);
                model
                    .usual
                    .iter()
                    .enumerate()
                    .for_each(|(a, usual)| move_motion(&mut hyp.p, motion_of(a), usual, moved_s));
                let own = hyp.marks.iter_mut().zip(&model.channels).filter(|one| one.1.clock == Some(parameter));
                own.for_each(|(own, _)| own.met_s = own.met_s.max(mark.at_s));
            }
        }
        match judge {
            Judge::Open { undecided, back, .. } => {
                undecided.add(mark, (0..self.hyps.count()).map(Survivor::unchanged));
                *back = None;
            }
            Judge::Alone(alone) => alone.undecided.add(mark, std::iter::once(Survivor::unchanged(0))),
            Judge::Decided { .. } => {}
        }
    }

    /// Puts the measurements of the same instant as `items[j]` in the order of how well they agree with the best
    /// hypothesis, so that what is found does not depend on the order of targets. Returns where they end.
    fn order_frame(&self, model: &Model, items: &mut [Timed], j: usize, place: &Place, work: &mut Work) -> usize {
        let at_s = items[j].at_s;
        let same = |one: &&Timed| one.at_s == at_s && one.channel().is_some();
        let end = j + items[j..].iter().take_while(same).count();
        let mut off: Vec<(f64, Timed)> = Vec::with_capacity(end - j);
        for item in &items[j..end] {
            let Item::Measured(row) = &item.item else { continue };
            let innovation = look(self.hyps.best(), &scene_of(model, &self.motion, row, at_s, place), work);
            off.push((innovation.error * innovation.error / innovation.total(), *item));
        }
        off.sort_by(|a, b| a.0.total_cmp(&b.0));
        for (item, (_, ordered)) in items[j..end].iter_mut().zip(off) {
            *item = ordered;
        }
        end
    }
}

/// A measurement at its place.
fn scene_of<'a>(
    model: &'a Model,
    motion: &'a [AxisMotion],
    row: &'a Measurement,
    at_s: f64,
    place: &Place,
) -> Scene<'a> {
    let channel = &model.channels[row.channel];
    let (a, theta) = (channel.row.axis, place.since_s / place.dt);
    let input = motion[a].input;
    let acceleration = input + theta * (place.end[a] - input);
    Scene { model, row, channel, at_s, motion, acceleration, density: place.density[a] }
}

/// Lets all hypotheses meet a measurement; returns whether one alone has taken it as a good one, and left its record.
#[inline]
fn judge_open(
    (hyps, judged, watch): (&mut Hypotheses, &mut usize, &mut Watch),
    scene: &Scene,
    back: Option<&mut WayBack>,
    work: &mut Work,
) -> bool {
    let c = scene.row.channel;
    let count = hyps.count();
    let best = hyps.best_mut();
    let was_away = best.marks[c].begun && is_back(best, scene);
    let made = meet_zero(best, scene);
    let mark = &best.marks[c];
    // After a gap the causes are weighed: the first measurement tells no earlier step.
    let is_late = scene.at_s - mark.met_s > scene.channel.coasting_s;
    let usual = best.memory.burst.is_none() && mark.outliers == 0.0 && !is_late;
    let innovation = look(best, scene, work);
    if *judged == 0 {
        watch.note(scene, &innovation, &work.e, was_away);
    }
    let is_inside = innovation.within(GATE) && innovation.with_parameters <= VAGUE * innovation.noise;
    if count == 1 && *judged == 0 && usual && is_inside {
        let total = take_good(best, scene, &innovation, work);
        if let Some(back) = back {
            back.leave_record(scene.at_s, c, Some(total), made, work);
        }
        if !scene.channel.places {
            return true;
        }
        let is_step = scene.model.looks_for_steps() && find_step(best, scene, SURE);
        hyps.add_evidence(log_normal(innovation.error, innovation.total()));
        return !is_step;
    }
    hyps.meet_others(scene);
    let first = *judged > 0;
    hyps.split(scene, work, first);
    if first {
        pass_first(hyps, judged, scene);
    }
    false
}

/// Counts one of the first measurements of where the structure is: no step is asked for among them, as little is known
/// of the start.
fn pass_first(hyps: &mut Hypotheses, judged: &mut usize, scene: &Scene) {
    for hyp in hyps.all_mut() {
        hyp.clear_tests();
    }
    *judged -= usize::from(scene.channel.places);
}

/// Takes a measurement of a sound channel as a good one.
#[inline]
fn take_good(hyp: &mut Hypothesis, scene: &Scene, innovation: &Innovation, work: &mut Work) -> f64 {
    hyp.marks[scene.row.channel].met_s = scene.at_s;
    hyp.memory.parent = 0;
    hyp.memory.decision = Decision::GOOD;
    accept(hyp, scene, innovation, work)
}

/// Takes a measurement as was decided, and leaves its record for the pass back.
#[inline]
fn take_decided(hyp: &mut Hypothesis, decision: Decision, scene: &Scene, back: Option<&mut WayBack>, work: &mut Work) {
    let c = scene.row.channel;
    let made = meet_zero(hyp, scene);
    let (total, restored) = if decision.cause == Cause::Good && !decision.burst_ended && !decision.explained {
        let innovation = look(hyp, scene, work);
        (Some(take_good(hyp, scene, &innovation, work)), false)
    } else {
        let taken = apply(decision, hyp, scene, work);
        (taken.total, taken.restored)
    };
    if let Some(back) = back {
        let made = if restored { Scaled { shift: Turn::GONE, ..made } } else { made };
        back.leave_record(scene.at_s, c, total, made, work);
    }
}

/// Lets one hypothesis take a measurement as good, or leave it out where that is likelier; item: its number among
/// those of the run, and itself.
fn take_alone(hyp: &mut Hypothesis, alone: &mut Alone, scene: &Scene, (j, item): (usize, Timed), work: &mut Work) {
    meet_zero(hyp, scene);
    let (innovation, p) = (look(hyp, scene, work), scene.model.rates.outlier);
    let good = (1.0 - p).ln() + log_normal(innovation.error, innovation.total());
    let wrong = p.ln() + log_wrong(innovation.error, innovation.total(), innovation.noise);
    let (more, less) = if good >= wrong { (good, wrong) } else { (wrong, good) };
    if scene.channel.places {
        alone.log_likelihood += more + (less - more).exp().ln_1p();
    }
    if alone.untaken.get(j).copied().unwrap_or(false) {
        return;
    }
    if good >= wrong {
        take_good(hyp, scene, &innovation, work);
    } else {
        apply(Decision::of(Cause::Outlier), hyp, scene, work);
        hyp.memory.parent = 0;
    }
    alone.undecided.add(item, std::iter::once(Survivor::of(hyp)));
}
