//! How the pass back counts the states, so that zeros of which nothing is known are wide in one state alone.

use super::decided::Decided;
use super::hypothesis::Hypothesis;
use super::layout::motion_of;
use super::model::Model;
use super::row::Entry;

/// How the pass back counts the states, and by which parameters.
///
/// x becomes x + z of the channel that all of an axis count from, where its zero is unknown, and the zeros of the others of
/// which nothing is known become what they differ from it by. Until a known zero begins, x and those zeros are only known
/// relative to each other; so they are wide in one of the new states alone.
#[derive(Clone, Debug)]
pub struct Counting {
    /// Of each axis the zero that all count from, and the unknown zeros that are counted from it.
    pub(super) common: Vec<Option<(usize, Vec<usize>)>>,
    /// Each channel's row as the states are counted.
    pub(super) rows: Vec<Vec<Entry>>,
    /// States (n,) that are counted from another one or others from it: uncertain in any case.
    pub(super) counted: Vec<bool>,
}

/// What a pass back goes by.
#[derive(Clone, Copy, Debug)]
pub struct Counted<'a> {
    /// The model.
    pub model: &'a Model,
    /// How the states are counted.
    pub counting: &'a Counting,
    /// The filter at the record's end.
    pub last: &'a Hypothesis,
}

impl Counting {
    /// Before: the filter at the beginning of what was decided.
    pub fn new(model: &Model, before: &Hypothesis, parts: &[&Decided]) -> Self {
        let common: Vec<_> = (0..model.axes()).map(|a| common_zero(model, a, before, parts)).collect();
        let rows =
            model.channels.iter().map(|channel| counted_row(&channel.row.entries, channel.row.axis, &common)).collect();
        let mut counted = vec![false; model.size()];
        for (zero, others) in common.iter().flatten() {
            counted[*zero] = true;
            for &other in others {
                counted[other] = true;
            }
        }
        Self { common, rows, counted }
    }

    /// A vector (n,) of covariances or gains as the states are counted.
    #[inline]
    pub fn count(&self, v: &mut [f64]) {
        for (a, common) in self.common.iter().enumerate() {
            if let Some((zero, others)) = common {
                let own = v[*zero];
                v[motion_of(a)] += own;
                for &other in others {
                    v[other] -= own;
                }
            }
        }
    }

    /// Whether it counts as it would after what was decided.
    pub fn holds(&self, model: &Model, before: &Hypothesis, parts: &[&Decided]) -> bool {
        self.common.iter().enumerate().all(|(a, common)| *common == common_zero(model, a, before, parts))
    }

    /// Whether any state is counted otherwise.
    pub fn counts(&self) -> bool {
        self.common.iter().any(Option::is_some)
    }
}

/// The unknown zero that an axis counts from on the way back, its first channel's, and the other unknown ones.
fn common_zero(model: &Model, a: usize, before: &Hypothesis, parts: &[&Decided]) -> Option<(usize, Vec<usize>)> {
    let own = |c: usize| model.channels[c].row.axis == a;
    let begun = |c: &usize| own(*c) && before.marks[*c].begun;
    let known = |c: &usize| model.channels[*c].zero_variance.is_some();
    let all = || 0..model.channels.len();
    let met = || {
        let items = parts.iter().flat_map(|part| part.items.iter().zip(&part.decisions));
        items.filter(|(_, decision)| !decision.is_outlier()).filter_map(|(item, _)| item.channel()).find(|&c| own(c))
    };
    let first = all().filter(begun).find(known).or_else(|| all().find(begun)).or_else(met)?;
    if known(&first) {
        return None;
    }
    let others = all().filter(|&c| c != first && own(c) && !known(&c)).map(|c| model.channels[c].zero).collect();
    Some((model.channels[first].zero, others))
}

/// A row as the states are counted: x = x' − z, and the other unknown zeros are z' + z.
fn counted_row(entries: &[Entry], axis: usize, common: &[Option<(usize, Vec<usize>)>]) -> Vec<Entry> {
    let mut counted = entries.to_vec();
    let Some(Some((zero, others))) = common.get(axis) else { return counted };
    let place = motion_of(axis);
    let mut factor = 0.0;
    for entry in entries {
        if entry.state == *zero || others.contains(&entry.state) {
            factor += entry.factor;
        } else if entry.state == place {
            factor -= entry.factor;
        }
    }
    counted.retain(|one| one.state != *zero);
    if factor != 0.0 {
        counted.push(Entry { state: *zero, factor });
    }
    counted
}
