//! What the hypotheses decided: final where all of them have one past.

use super::cause::{Cause, Decision};
use super::hypotheses::MAX_FIRST;
use super::hypothesis::{Contradiction, Hypothesis};
use super::run::Filter;
use super::samples::Samples;
use super::start::Beginning;
use super::waiting::{Item, Timed};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The newest measurements, up to this number, may be undecided; what the older ones were the best hypothesis decides.
pub const MAX_UNDECIDED: usize = 2048;

/// A hypothesis after an item: which one before it that it came from, and what it took the item for.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Survivor {
    parent: usize,
    decision: Decision,
    evidence: Contradiction,
}

impl Survivor {
    /// Of a hypothesis that has just met an item.
    pub fn of(hyp: &Hypothesis) -> Self {
        let memory = &hyp.memory;
        let evidence = if memory.decision.cause == Cause::StepBefore { memory.step } else { memory.met };
        Self { parent: memory.parent, decision: memory.decision, evidence }
    }

    /// Of the hypothesis `b` that went on as it was.
    pub fn unchanged(b: usize) -> Self {
        Self { parent: b, decision: Decision::GOOD, evidence: Contradiction::default() }
    }
}

/// Items, what each was taken for, and the evidence for it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Decided {
    /// The items, in time order.
    pub items: Vec<Timed>,
    /// What each was taken for.
    pub decisions: Vec<Decision>,
    /// The evidence for it.
    pub evidence: Vec<Contradiction>,
}

impl Decided {
    /// How many there are.
    pub fn len(&self) -> usize {
        self.items.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.items.is_empty()
    }

    /// Adds others behind.
    pub fn extend(&mut self, other: &Self) {
        self.items.extend_from_slice(&other.items);
        self.decisions.extend_from_slice(&other.decisions);
        self.evidence.extend_from_slice(&other.evidence);
    }

    /// Forgets all.
    pub fn clear(&mut self) {
        self.drop_first(self.len());
    }

    /// Drops those later than an instant, s.
    pub fn drop_after(&mut self, at_s: f64) {
        let count = self.items.partition_point(|one| one.at_s <= at_s);
        self.items.truncate(count);
        self.decisions.truncate(count);
        self.evidence.truncate(count);
    }

    /// Drops the first ones.
    pub fn drop_first(&mut self, count: usize) {
        self.items.drain(..count);
        self.decisions.drain(..count);
        self.evidence.drain(..count);
    }

    /// Whether all parts are as long as each other and all channels exist.
    pub fn fits(&self, channels: usize) -> bool {
        let n = self.len();
        self.decisions.len() == n && self.evidence.len() == n && channels_exist(self.items.iter(), channels)
    }

    fn push(&mut self, item: Timed, one: &Survivor) {
        self.items.push(item);
        self.decisions.push(one.decision);
        self.evidence.push(one.evidence);
    }
}

/// Whether the channels of all items exist.
pub fn channels_exist<'a>(items: impl Iterator<Item = &'a Timed>, channels: usize) -> bool {
    items.filter_map(Timed::channel).all(|c| c < channels)
}

/// Items of which the hypotheses do not say the same yet, and what each of as many hypotheses as there were took them
/// for.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Undecided {
    /// What is final, until it is taken over.
    pub settled: Decided,
    items: Vec<Timed>,
    /// Where the survivors of each item end.
    ends: Vec<usize>,
    survivors: Vec<Survivor>,
}

impl Undecided {
    /// Adds an item and what each hypothesis took it for; of one alone it is final.
    #[inline]
    pub fn add(&mut self, item: Timed, survivors: impl ExactSizeIterator<Item = Survivor>) {
        let alone = survivors.len() == 1;
        if alone && self.items.is_empty() {
            survivors.for_each(|one| self.settled.push(item, &one));
            return;
        }
        self.items.push(item);
        self.survivors.extend(survivors);
        self.ends.push(self.survivors.len());
        if alone {
            self.settle(1);
        }
    }

    /// How many items there are.
    pub fn len(&self) -> usize {
        self.items.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.items.is_empty()
    }

    /// The time of the first one, s.
    pub fn first_s(&self) -> Option<f64> {
        self.items.first().map(|one| one.at_s)
    }

    /// Whether it is consistent, given this many hypotheses and channels.
    pub fn fits(&self, count: usize, channels: usize) -> bool {
        let mut before = (0, usize::MAX);
        let each = self.ends.iter().all(|&end| {
            let sound = end > before.0
                && end <= self.survivors.len()
                && end - before.0 <= MAX_FIRST
                && self.survivors[before.0..end].iter().all(|one| before.1 == usize::MAX || one.parent < before.1);
            before = (end, end - before.0);
            sound
        });
        each && self.ends.len() == self.items.len()
            && self.ends.last().copied().unwrap_or(0) == self.survivors.len()
            && (self.items.is_empty() || before.1 == count)
            && channels_exist(self.items.iter(), channels)
    }

    fn of(&self, j: usize) -> &[Survivor] {
        let first = if j == 0 { 0 } else { self.ends[j - 1] };
        &self.survivors[first..self.ends[j]]
    }

    /// What is not taken over: what is final, and what the best one says of the others.
    pub fn all(&self) -> Decided {
        let mut all = self.settled.clone();
        all.extend(&self.best());
        all
    }

    /// What the best one says of all items that are not final.
    pub fn best(&self) -> Decided {
        let mut best = Decided::default();
        for (j, &place) in self.path(0).iter().enumerate() {
            best.push(self.items[j], &self.of(j)[place]);
        }
        best
    }

    /// What a hypothesis took each item for, those that are final too.
    pub fn decisions_of(&self, b: usize) -> Vec<Decision> {
        let open = self.path(b).into_iter().enumerate().map(|(j, place)| self.of(j)[place].decision);
        self.settled.decisions.iter().copied().chain(open).collect()
    }

    /// The places of a hypothesis' past among the survivors of each item.
    fn path(&self, b: usize) -> Vec<usize> {
        let (mut places, mut at) = (vec![0; self.len()], b);
        for j in (0..self.len()).rev() {
            places[j] = at;
            at = self.of(j)[at].parent;
        }
        places
    }

    /// Lets what is final, given this many hypotheses, be settled.
    pub fn settle(&mut self, count: usize) {
        let settled = self.one_past(count).max(self.len().saturating_sub(MAX_UNDECIDED));
        if settled == 0 {
            return;
        }
        for (j, &place) in self.path(0)[..settled].iter().enumerate() {
            let one = self.of(j)[place];
            self.settled.push(self.items[j], &one);
        }
        let end = self.ends[settled - 1];
        self.items.drain(..settled);
        self.survivors.drain(..end);
        self.ends.drain(..settled);
        for one in &mut self.ends {
            *one -= end;
        }
    }

    /// Up to which item all hypotheses have one past.
    fn one_past(&self, count: usize) -> usize {
        if count == 1 {
            return self.len();
        }
        let mut at: Vec<usize> = (0..count).collect();
        for j in (0..self.len()).rev() {
            let survivors = self.of(j);
            for place in &mut at {
                *place = survivors[*place].parent;
            }
            if at.windows(2).all(|two| two[0] == two[1]) {
                return j;
            }
        }
        0
    }
}

/// The filter with its best hypothesis alone, after this many decided measurements, and what that took those for that
/// were not decided yet.
#[derive(Clone, Debug)]
pub struct Logged {
    /// The filter.
    pub filter: Filter,
    /// How many items were decided.
    pub decided: usize,
    /// What the best hypothesis took the next ones for.
    pub open: Vec<Decision>,
}

/// The log of an estimator.
#[derive(Clone, Debug)]
pub struct Log {
    /// The state before the first sample.
    pub begin: Beginning,
    /// Time of the first measurement, from which on rows are given, s.
    pub first_s: f64,
    /// What times in s count from, ns.
    pub origin_ns: i64,
    /// The samples.
    pub samples: Samples,
    /// What was decided.
    pub decided: Decided,
    /// The filter after this many samples, multiples of a block.
    pub filters: BTreeMap<usize, Logged>,
}

impl Log {
    /// Nothing yet.
    pub fn new(begin: Beginning, first_s: f64, origin_ns: i64, axes: usize) -> Self {
        let (samples, decided) = (Samples::none(axes), Decided::default());
        Self { begin, first_s, origin_ns, samples, decided, filters: BTreeMap::new() }
    }

    /// Times (s) from which on clocks were in doubt, as stamps had gone back.
    pub fn went_back_s(&self) -> Vec<f64> {
        self.decided.items.iter().filter(|one| one.item == Item::WentBack).map(|one| one.at_s).collect()
    }
}
