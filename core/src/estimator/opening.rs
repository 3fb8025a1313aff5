//! The first rows of a stream: they wait for the first measurements, which are judged by those after them.

use super::cause::Decision;
use super::decided::{Log, Undecided};
use super::innovation::Work;
use super::model::{Model, instant, since};
use super::rows::{Innovations, Output, Rows, mixed};
use super::run::{Block, Filter, Judge};
use super::samples::{Samples, View};
use super::start::{Beginning, with_start};
use super::stream::Estimator;
use super::waiting::{Item, Timed, put_in_order};

/// So many measurements, one of them of the sensor whose zero counts, are waited for before rows are given out.
const FIRST_MEASUREMENTS: usize = 8;
/// Or so long after the first one, s.
const FIRST_S: f64 = 2.0;
/// A zero longer before the first measurement than this (s) is not followed from there: the rows count from the latter.
const MAX_BEFORE_S: f64 = 10.0;
/// A first measurement before the first sample counts when it is no more than this (s) before it.
const BEFORE_SAMPLES_S: f64 = 2.0;

impl Estimator {
    /// Starts once enough measurements are there; until then holds the samples from before the first one on.
    pub(super) fn begin(&mut self, mut held: Samples, ended: bool, found: &mut Option<Output>) {
        let (origin_ns, mut time_s) = (self.origin_ns(), Vec::new());
        held.view().seconds(origin_ns, &mut time_s);
        let (Some(&sampled_s), Some(&end_s)) = (time_s.first(), time_s.last()) else { return };
        self.memory.waiting.retain(|one| one.at_s >= sampled_s - BEFORE_SAMPLES_S);
        let count = self.count_due(end_s);
        let first_s = if count > 0 { self.memory.waiting[0].at_s } else { end_s };
        let start_s = self.start_s(first_s, sampled_s);
        let dropped = time_s.partition_point(|&one| one <= start_s).saturating_sub(1);
        held.drop_first(dropped);
        time_s.drain(..dropped);
        if count == 0 {
            self.memory.held = Some(held);
            return;
        }
        let is_enough = count >= FIRST_MEASUREMENTS && self.tells_zero(count, first_s);
        let enough = is_enough.then(|| self.memory.waiting[FIRST_MEASUREMENTS - 1].at_s);
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
        self.start(begun.view(), first_s, found.get_or_insert_default());
        if last + 1 < whole.len() {
            self.run(whole.part(last + 1, whole.len()), None, found);
        }
    }

    /// When the filter starts, s: at the first measurement, or at the zero where that lies shortly before it, but not before
    /// the first sample: without acceleration the zero would be uncertain by decimetres.
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
            || !self.settings.channels.iter().any(|channel| channel.zero_known())
            || self.memory.waiting.iter().take(count).any(|one| match &one.item {
                Item::Measured(row) => self.settings.channels[row.channel].zero_known(),
                _ => false,
            })
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
        let begin = Beginning::new(samples, &time_s, &items, &self.settings, &self.model);
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
        let mut open = Judge::Open { undecided: &mut undecided, innovations, origin_ns, back: None };
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
            for ((item, told), &decision) in one.items.iter().zip(&one.told).zip(&one.decisions) {
                let Some(c) = item.channel() else { continue };
                let units_per_m = self.model.channels[c].row.units_per_m;
                output.innovations[c].push(instant(item.at_s, origin_ns), units_per_m, told, decision);
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
