//! What is reported of final decisions: one event for each cause, of which Python makes sentences.

use super::cause::{Cause, Prior};
use super::decided::Decided;
use super::model::{Model, instant};
use super::situation::WILD;
use serde::{Deserialize, Serialize};

/// Outliers in a row that are an event; a wild one alone is.
const MIN_RUN: usize = 5;
/// Causes of one kind that are closer (s) are one.
pub const ONE_CAUSE_S: f64 = 2.0;

/// What is reported.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum What {
    /// Measurements came too late.
    Late,
    /// Too many measurements wait.
    Overflow,
    /// Outliers in a row.
    Rejected {
        /// How many.
        count: usize,
        /// From the first to the last of them, s.
        lasting_s: f64,
    },
    /// An outlier so far off that nothing moves so fast.
    Wild,
    /// A zero shifted.
    Shifted,
    /// A zero went back.
    Returned,
    /// The acceleration was wrong.
    Wrong,
    /// The motion was started anew.
    Lost,
    /// The noise rose.
    Noise,
    /// A clock stepped; its size and standard deviation are in ms.
    Clock,
}

/// One event.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// When, ns.
    pub time_ns: i64,
    /// Of which channel.
    pub channel: usize,
    /// What.
    pub what: What,
    /// Size, mm.
    pub size_mm: f64,
    /// Its standard deviation, mm.
    pub std_mm: f64,
}

impl Report {
    /// One without a size.
    pub fn of(time_ns: i64, channel: usize, what: What) -> Self {
        Self { time_ns, channel, what, size_mm: 0.0, std_mm: 0.0 }
    }
}

/// Outliers of a channel in a row.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
struct Run {
    first_s: f64,
    last_s: f64,
    count: usize,
    first_mm: f64,
}

/// The kinds of causes that are one event where they are close.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
enum Kind {
    Wild,
    Zero,
    Wrong,
    Lost,
    Noise,
}

/// The last cause of a kind, of a sensor along an axis.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct LastCause {
    kind: Kind,
    group: usize,
    at_s: f64,
}

/// What the events remember.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Reports {
    runs: Vec<Run>,
    causes: Vec<LastCause>,
}

impl Reports {
    /// Before the first measurement.
    pub fn new(channels: usize) -> Self {
        Self { runs: vec![Run::default(); channels], causes: Vec::new() }
    }

    /// Whether it is of this many channels.
    pub fn fits(&self, channels: usize) -> bool {
        self.runs.len() == channels
    }

    /// The events that final decisions complete, in time order.
    pub fn after(&mut self, decided: &Decided, model: &Model, origin_ns: i64) -> Vec<Report> {
        let mut reports = Vec::new();
        for ((item, decision), evidence) in decided.items.iter().zip(&decided.decisions).zip(&decided.evidence) {
            // Causes of auxiliary channels are no events: their sizes are no displacements.
            let Some(c) = item.channel().filter(|&c| model.channels[c].places) else { continue };
            let before = decision.cause == Cause::StepBefore;
            let unit = if before { 1.0 } else { model.channels[c].row.units_per_m.abs() };
            let (size_mm, std_mm) = (1e3 * evidence.size / unit, 1e3 * evidence.variance.sqrt() / unit);
            let at_s = if before { item.at_s - evidence.ago_s } else { item.at_s };
            let run = &mut self.runs[c];
            let Some((what, kind)) = reported(decision.cause) else {
                reports.extend(end_run(run, c, origin_ns));
                continue;
            };
            if kind == Kind::Wild {
                let another = run.count > 0;
                *run = if another {
                    Run { last_s: at_s, count: run.count + 1, ..*run }
                } else {
                    Run { first_s: at_s, last_s: at_s, count: 1, first_mm: size_mm }
                };
                if another || size_mm * size_mm <= WILD * std_mm * std_mm {
                    continue;
                }
            } else {
                reports.extend(end_run(run, c, origin_ns));
            }
            if self.is_new(LastCause { kind, group: model.channels[c].group, at_s }) {
                reports.push(Report { time_ns: instant(at_s, origin_ns), channel: c, what, size_mm, std_mm });
            }
        }
        reports.sort_by_key(|one| one.time_ns);
        reports
    }

    /// Whether a cause is another one than the last of its kind, which it becomes.
    fn is_new(&mut self, cause: LastCause) -> bool {
        let same = |one: &&mut LastCause| one.kind == cause.kind && one.group == cause.group;
        match self.causes.iter_mut().find(same) {
            Some(last) => {
                let close = cause.at_s - last.at_s < ONE_CAUSE_S;
                last.at_s = cause.at_s;
                !close
            }
            None => {
                self.causes.push(cause);
                true
            }
        }
    }

    /// The runs of outliers that the record's end cut off.
    pub fn ended(&mut self, origin_ns: i64) -> Vec<Report> {
        let mut reports = Vec::new();
        for (c, run) in self.runs.iter_mut().enumerate() {
            let mut last = *run;
            reports.extend(end_run(&mut last, c, origin_ns));
        }
        reports
    }
}

/// What is reported of a cause; None of a good measurement.
fn reported(cause: Cause) -> Option<(What, Kind)> {
    match cause {
        Cause::Good => None,
        Cause::Outlier => Some((What::Wild, Kind::Wild)),
        Cause::Shift(Prior::FormerZero) => Some((What::Returned, Kind::Zero)),
        Cause::Shift(Prior::AnySize | Prior::Reverting(_) | Prior::ReportedLater) | Cause::StepBefore => {
            Some((What::Shifted, Kind::Zero))
        }
        Cause::Wrong => Some((What::Wrong, Kind::Wrong)),
        Cause::Lost => Some((What::Lost, Kind::Lost)),
        Cause::Noise => Some((What::Noise, Kind::Noise)),
    }
}

/// Ends a run of outliers, which is an event where it was long enough.
fn end_run(run: &mut Run, channel: usize, origin_ns: i64) -> Option<Report> {
    let ended = std::mem::take(run);
    (ended.count >= MIN_RUN).then(|| Report {
        time_ns: instant(ended.first_s, origin_ns),
        channel,
        what: What::Rejected { count: ended.count, lasting_s: ended.last_s - ended.first_s },
        size_mm: ended.first_mm,
        std_mm: 0.0,
    })
}
