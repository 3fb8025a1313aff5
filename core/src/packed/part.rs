//! The rows of one point in a pack: runs, then the columns; and a check sum of both.

use super::bits::{Reader, put_number, unzigzag, zigzag};
use super::{Fault, column};
use crate::rows::Rows;

/// Rows of a part at most: eleven hours at 100 Hz.
const MAX_ROWS: usize = 1 << 22;
/// Stamps are this far from 1970 at most, ns: the year 2116.
const MAX_NS: i64 = 1 << 62;

/// One run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Run {
    pub t0_ns: i64,
    pub dt_ns: i64,
    pub count: u32,
    pub status: u8,
}

impl Run {
    /// Stamp of the last row. Number where it is out of range, or the run has no rows or goes back in time.
    fn last_ns(&self) -> Result<i64, Fault> {
        if self.count == 0 || self.dt_ns < i64::from(self.count > 1) || !(-MAX_NS..MAX_NS).contains(&self.t0_ns) {
            return Err(Fault::Number);
        }
        let length_ns = self.dt_ns.checked_mul(i64::from(self.count - 1)).ok_or(Fault::Number)?;
        let last_ns = self.t0_ns.checked_add(length_ns).ok_or(Fault::Number)?;
        if last_ns < MAX_NS { Ok(last_ns) } else { Err(Fault::Number) }
    }
}

/// Stamps of the first and the last row, ns, and how many there are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Span {
    /// Stamp of the first row.
    pub first_ns: i64,
    /// Stamp of the last row.
    pub last_ns: i64,
    /// How many there are.
    pub rows: usize,
}

impl Span {
    /// Both together, this one the earlier.
    pub fn and(self, later: Span) -> Self {
        Self { first_ns: self.first_ns, last_ns: later.last_ns, rows: self.rows + later.rows }
    }
}

/// First and last stamp of runs in the order of time, and how many rows they have.
fn span_of(runs: &[Run]) -> Result<Span, Fault> {
    let first = runs.first().ok_or(Fault::Runs)?;
    let (mut last_ns, mut rows) = (first.t0_ns - 1, 0);
    for run in runs {
        if run.t0_ns <= last_ns {
            return Err(Fault::Runs);
        }
        last_ns = run.last_ns()?;
        rows += run.count as usize;
        if rows > MAX_ROWS {
            return Err(Fault::Runs);
        }
    }
    Ok(Span { first_ns: first.t0_ns, last_ns, rows })
}

/// Append a part: length, check sum, runs and columns. Runs that do not follow each other are a Fault.
pub fn put(out: &mut Vec<u8>, runs: &[Run], columns: [&[f64]; 3]) -> Result<(), Fault> {
    let span = span_of(runs)?;
    if columns.iter().any(|values| values.len() != span.rows) {
        return Err(Fault::Runs);
    }
    let mut body = Vec::with_capacity(64 + 4 * span.rows);
    put_number(&mut body, runs.len() as u64);
    body.extend_from_slice(&span.first_ns.to_le_bytes());
    let mut next_ns = span.first_ns;
    for run in runs {
        put_number(&mut body, zigzag(run.t0_ns.wrapping_sub(next_ns)));
        put_number(&mut body, run.dt_ns as u64);
        put_number(&mut body, u64::from(run.count));
        body.push(run.status);
        next_ns = run.last_ns()?.wrapping_add(run.dt_ns);
    }
    columns.iter().for_each(|values| column::put(&mut body, values));
    put_number(out, body.len() as u64);
    out.extend_from_slice(&crc32fast::hash(&body).to_le_bytes());
    out.extend_from_slice(&body);
    Ok(())
}

/// A part that has been found, with its bytes.
#[derive(Clone, Copy, Debug)]
pub struct Part<'a> {
    /// With length and check sum.
    pub whole: &'a [u8],
    body: &'a [u8],
}

/// The parts of a point's bytes, each checked.
pub fn parts(area: &[u8]) -> Parts<'_> {
    Parts(Reader(area))
}

/// See [`parts`].
pub struct Parts<'a>(Reader<'a>);

impl<'a> Iterator for Parts<'a> {
    type Item = Result<Part<'a>, Fault>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.0.0.is_empty() {
            return None;
        }
        let found = part(&mut self.0);
        if found.is_err() {
            self.0 = Reader(&[]);
        }
        Some(found)
    }
}

fn part<'a>(reader: &mut Reader<'a>) -> Result<Part<'a>, Fault> {
    let before = reader.0;
    let length = reader.length()?;
    let sum = u32::from_le_bytes(reader.array()?);
    let body = reader.take(length)?;
    if crc32fast::hash(body) != sum {
        return Err(Fault::Checksum);
    }
    Ok(Part { whole: &before[..before.len() - reader.0.len()], body })
}

impl<'a> Part<'a> {
    /// Its runs, and what follows them.
    fn runs(&self) -> Result<(Vec<Run>, Reader<'a>), Fault> {
        let mut reader = Reader(self.body);
        let count = reader.length()?;
        let mut next_ns = i64::from_le_bytes(reader.array()?);
        let mut runs = Vec::new();
        for _ in 0..count {
            let t0_ns = next_ns.wrapping_add(unzigzag(reader.number()?));
            let dt_ns = i64::try_from(reader.number()?).map_err(|_| Fault::Number)?;
            let count = u32::try_from(reader.number()?).map_err(|_| Fault::Number)?;
            let [status] = reader.array()?;
            let run = Run { t0_ns, dt_ns, count, status };
            next_ns = run.last_ns()?.wrapping_add(dt_ns);
            runs.push(run);
        }
        Ok((runs, reader))
    }

    /// First and last stamp and number of rows, without the columns.
    pub fn span(&self) -> Result<Span, Fault> {
        span_of(&self.runs()?.0)
    }

    /// Append the rows, as those of a point.
    pub fn read(&self, point: u32, velocity: bool, rows: &mut Rows) -> Result<(), Fault> {
        let (runs, mut reader) = self.runs()?;
        let span = span_of(&runs)?;
        for run in runs {
            rows.point.push(point);
            rows.t0_ns.push(run.t0_ns);
            rows.dt_ns.push(run.dt_ns);
            rows.count.push(run.count);
            rows.status.push(run.status);
        }
        let wanted = if velocity { 3 } else { 2 };
        for values in &mut rows.columns[..wanted] {
            reader = column::read(reader, span.rows, values)?;
        }
        if velocity && !reader.0.is_empty() {
            return Err(Fault::Length);
        }
        Ok(())
    }
}
