//! What a measurement far from its prediction means: hypotheses, each a filter of its own, weighed by their likelihood.
//!
//! While measurements agree with their predictions there is one hypothesis: that they are good. One that does not agree
//! splits each hypothesis by what may have happened just then, see [`super::cause`]. Each goes on as a filter of its
//! own; the likelihood of what is measured later decides. Hypotheses that fall behind the best are dropped, those that
//! have come to agree are one again, and no more than a fixed number is kept.

use super::cause::{Cause, Decision, apply, log_ends};
use super::hypothesis::{Hypothesis, Mark};
use super::innovation::{Scene, Work, look, meet_zero};
use super::model::{ChannelModel, Model};
use super::situation::Situation;
use serde::{Deserialize, Serialize};

/// How many hypotheses are kept while the first measurements are judged, any of which may be outliers.
pub const MAX_FIRST: usize = 64;
/// And later.
const MAX_LATER: usize = 32;
/// While the first are judged one may fall behind by this many times the odds: three outliers in a row may look like
/// motion until the fifth.
const FIRST_ODDS: f64 = 2.0;
/// Two are one again where every state agrees to a fifth of its standard deviation, its variance to a tenth and the
/// noise to a fifth: what is lost by that is below a hundredth of the band.
const SAME_MEAN: f64 = 0.05;
const SAME_VARIANCE: f64 = 0.1;
const SAME_NOISE: f64 = 0.2;
const TINY: f64 = 1e-24;
/// After this many good measurements half the odds are enough to drop a hypothesis, after twice as many a third: what
/// they have not distinguished they will not.
const SETTLES: f64 = 20.0;
const KINDS: usize = Cause::CANDIDATES.len();

/// All hypotheses; the best one comes first.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Hypotheses {
    count: usize,
    slots: Vec<Hypothesis>,
    /// Logarithm of the best one's likelihood times its prior: what the weights are counted from.
    evidence: f64,
    #[serde(skip)]
    next: Vec<Hypothesis>,
    #[serde(skip)]
    weights: Vec<f64>,
    #[serde(skip)]
    order: Vec<usize>,
}

impl Hypotheses {
    /// One alone.
    pub fn one(hypothesis: Hypothesis) -> Self {
        Self { count: 1, slots: vec![hypothesis], ..Self::default() }
    }

    /// Leaves a copy of one alone.
    pub fn set_one(&mut self, hypothesis: &Hypothesis) {
        put(&mut self.slots, 0, hypothesis);
        self.count = 1;
    }

    /// Leaves the best one alone where all sensors are lost at a time (s).
    pub fn end_where_lost(&mut self, time_s: f64, model: &Model) {
        let mut marks = self.best().marks.iter().zip(&model.channels);
        let is_lost = |(mark, channel): (&Mark, &ChannelModel)| !channel.places || time_s - mark.met_s > channel.lost_s;
        if self.count > 1 && marks.all(is_lost) {
            self.count = 1;
        }
    }

    /// How many there are.
    pub fn count(&self) -> usize {
        self.count
    }

    /// All of them.
    #[inline]
    pub fn all(&self) -> &[Hypothesis] {
        &self.slots[..self.count]
    }

    /// All of them to change.
    #[inline]
    pub fn all_mut(&mut self) -> &mut [Hypothesis] {
        &mut self.slots[..self.count]
    }

    /// The best one.
    #[inline]
    pub fn best(&self) -> &Hypothesis {
        &self.slots[0]
    }

    /// The best one to change.
    #[inline]
    pub fn best_mut(&mut self) -> &mut Hypothesis {
        &mut self.slots[0]
    }

    /// Whether there is at least one and all are of the model's shape.
    pub fn fit(&self, model: &Model) -> bool {
        self.count >= 1
            && self.count <= MAX_FIRST
            && self.slots.len() >= self.count
            && self.slots.iter().all(|one| one.fits(model))
    }

    /// Logarithm of the likelihood of all that was measured, over all of them.
    pub fn evidence(&self) -> f64 {
        self.evidence + self.all().iter().map(|hyp| hyp.memory.weight.exp()).sum::<f64>().ln()
    }

    /// Adds the likelihood (logarithm) of a measurement that one alone has taken.
    pub fn add_evidence(&mut self, log_likelihood: f64) {
        self.evidence += log_likelihood;
    }

    /// Brings all but the best to a channel's measurement.
    pub fn meet_others(&mut self, scene: &Scene) {
        for hyp in &mut self.all_mut()[1..] {
            meet_zero(hyp, scene);
        }
    }

    /// Splits, weighs and prunes all by one measurement; first: it is one of the first, any of which may be outliers.
    ///
    /// A channel that tells nothing of where the structure is gives no evidence of a clock.
    pub fn split(&mut self, scene: &Scene, work: &mut Work, first: bool) {
        let before = self.evidence();
        self.split_by(scene, work, first);
        if !scene.channel.places {
            self.evidence += before - self.evidence();
        }
    }

    fn split_by(&mut self, scene: &Scene, work: &mut Work, first: bool) {
        let rates = &scene.model.rates;
        let (most, odds) = if first { (MAX_FIRST, FIRST_ODDS * rates.odds) } else { (MAX_LATER, rates.odds) };
        // What tells nothing of where the structure is, is not among those of which any may be an outlier.
        self.weigh(scene, work, first && scene.channel.places);
        self.order.clear();
        self.order.extend(0..self.weights.len());
        let weights = &self.weights;
        self.order.sort_by(|&a, &b| weights[b].total_cmp(&weights[a]));
        let top = self.order.first().map_or(f64::NEG_INFINITY, |&place| self.weights[place]);
        let (mut made, mut rejecting) = (0, 0);
        for &place in &self.order {
            let (b, cause, weight) = (place / KINDS, Cause::CANDIDATES[place % KINDS], self.weights[place]);
            if made == most / 2 || weight <= top - odds || weight.is_nan() || weight == f64::NEG_INFINITY {
                break;
            }
            if cause == Cause::Outlier {
                // Those that reject learn nothing: all of them together would keep out for ever what could take it.
                if rejecting == most / 4 {
                    continue;
                }
                rejecting += 1;
            }
            put(&mut self.next, made, &self.slots[b]);
            let hyp = &mut self.next[made];
            apply(Decision::of(cause), hyp, scene, work);
            hyp.memory.weight = weight;
            hyp.memory.parent = b;
            made += 1;
        }
        if made == 0 {
            // No cause has a weight, as where a measurement is not a number: all leave it out.
            for (b, hyp) in self.all_mut().iter_mut().enumerate() {
                (hyp.memory.parent, hyp.memory.decision) = (b, Decision::of(Cause::Outlier));
            }
            return;
        }
        let made = self.end_bursts(made, most, log_ends(scene.model));
        std::mem::swap(&mut self.slots, &mut self.next);
        self.count = made;
        self.prune(odds);
    }

    /// Logarithms of the weights of what each may become, (count · KINDS).
    fn weigh(&mut self, scene: &Scene, work: &mut Work, first: bool) {
        let mut sharpest = f64::INFINITY;
        for hyp in &self.slots[..self.count] {
            sharpest = sharpest.min(look(hyp, scene, work).total());
        }
        self.weights.clear();
        for hyp in &self.slots[..self.count] {
            let innovation = look(hyp, scene, work);
            let at = Situation::new(hyp, scene, innovation, &work.gain, (first, sharpest));
            // Where an error of the acceleration goes on, it may just have ended.
            let stays = if hyp.memory.burst.is_some() { scene.model.rates.stays.ln() } else { 0.0 };
            let prior = hyp.memory.weight + stays;
            self.weights.extend(Cause::CANDIDATES.iter().map(|cause| prior + cause.log_weight(&at)));
        }
    }

    /// Adds copies of those made in which the error of the acceleration has just ended; returns how many there are
    /// then.
    fn end_bursts(&mut self, made: usize, most: usize, log_ends: f64) -> usize {
        let mut count = made;
        for b in 0..made {
            if self.next[b].memory.burst.is_some() && count < most {
                let (before, behind) = self.next.split_at_mut(count);
                match behind.first_mut() {
                    Some(slot) => slot.copy_from(&before[b]),
                    None => {
                        let copy = self.next[b].clone();
                        self.next.push(copy);
                    }
                }
                let memory = &mut self.next[count].memory;
                memory.burst = None;
                memory.decision.burst_ended = true;
                memory.weight += log_ends;
                count += 1;
            }
        }
        count
    }

    /// Drops what fell behind or repeats a better one; the best comes first.
    fn prune(&mut self, odds: f64) {
        let hyps = &mut self.slots[..self.count];
        let mut best = 0;
        for b in 1..hyps.len() {
            if hyps[b].memory.weight > hyps[best].memory.weight {
                best = b;
            }
        }
        hyps.swap(0, best);
        let (top, oldest) = (hyps[0].memory.weight, hyps[0].memory.age);
        let mut kept = 0;
        for b in 0..hyps.len() {
            let age = hyps[b].memory.age.min(oldest);
            let mut keep = b == 0 || hyps[b].memory.weight > top - odds / (1.0 + age / SETTLES);
            for o in 0..kept {
                if keep && alike(&hyps[b], &hyps[o]) {
                    keep = false;
                    let (one, other) = (hyps[o].memory.weight, hyps[b].memory.weight);
                    hyps[o].memory.weight = one.max(other) + (one.min(other) - one.max(other)).exp().ln_1p();
                }
            }
            if keep {
                hyps.swap(kept, b);
                kept += 1;
            }
        }
        let top = hyps[0].memory.weight;
        self.evidence += top;
        for hyp in &mut hyps[..kept] {
            hyp.memory.weight -= top;
        }
        self.count = kept;
    }
}

/// Puts a copy into a slot, in the memory that it has.
fn put(slots: &mut Vec<Hypothesis>, place: usize, of: &Hypothesis) {
    match slots.get_mut(place) {
        Some(slot) => slot.copy_from(of),
        None => slots.push(of.clone()),
    }
}

/// Whether two hypotheses have come to say the same of every state, of the noise and of what goes on.
fn alike(one: &Hypothesis, other: &Hypothesis) -> bool {
    let density = |hyp: &Hypothesis| hyp.memory.burst.map(|burst| burst.density);
    if density(one) != density(other) {
        return false;
    }
    let marks = one.marks.iter().zip(&other.marks).all(|(mine, its)| {
        (mine.outliers > 0.0) == (its.outliers > 0.0)
            && mine.reverting_pace == its.reverting_pace
            && (its.factor / mine.factor - 1.0).abs() <= SAME_NOISE
    });
    marks
        && (0..one.p.width()).all(|i| {
            let (mine, its) = (one.p[(i, i)], other.p[(i, i)]);
            let off = one.x[(i, 0)] - other.x[(i, 0)];
            off * off <= SAME_MEAN * (mine + its) + TINY && (mine - its).abs() <= SAME_VARIANCE * mine.max(its) + TINY
        })
}
