//! A pack: an index with the point and the length of each, then their parts. Packs of later rows are joined by point.

use super::Fault;
use super::bits::{Reader, put_number};
use super::part::{self, Run, Span, parts};
use super::seconds::seconds;
use crate::rows::{Rows, RowsRef};

/// How a pack begins; then the index's check sum and length, the index (number of points, of each the steps from the
/// point before, and the length of its parts), and the parts.
pub const MAGIC: [u8; 4] = [b'm', b'g', 1, 0];

/// The parts of each point, by its number.
type Areas<'a> = Vec<(u32, &'a [u8])>;

/// Rows as a pack; those of each point in the order of time.
pub fn encode(rows: RowsRef<'_>) -> Result<Vec<u8>, Fault> {
    let runs = rows.point.len();
    let total: usize = rows.count.iter().map(|&count| count as usize).sum();
    let lengths = [rows.t0_ns.len(), rows.dt_ns.len(), rows.count.len(), rows.status.len()];
    if lengths.iter().any(|&length| length != runs) || rows.columns.iter().any(|values| values.len() != total) {
        return Err(Fault::Runs);
    }
    let mut places: Vec<(usize, usize)> = Vec::with_capacity(runs);
    let mut at = 0;
    for (run, &count) in rows.count.iter().enumerate() {
        places.push((run, at));
        at += count as usize;
    }
    places.sort_by_key(|&(run, _)| rows.point[run]);
    let (mut areas, mut body) = (Vec::new(), Vec::new());
    for own in places.chunk_by(|a, b| rows.point[a.0] == rows.point[b.0]) {
        let before = body.len();
        put_point(&mut body, rows, own)?;
        areas.push((rows.point[own[0].0], body.len() - before));
    }
    let mut out = head(&areas);
    out.extend_from_slice(&body);
    Ok(out)
}

/// Append the part of one point, whose runs begin at these rows.
fn put_point(body: &mut Vec<u8>, rows: RowsRef<'_>, own: &[(usize, usize)]) -> Result<(), Fault> {
    let runs: Vec<Run> = own
        .iter()
        .map(|&(run, _)| Run {
            t0_ns: rows.t0_ns[run],
            dt_ns: rows.dt_ns[run],
            count: rows.count[run],
            status: rows.status[run],
        })
        .collect();
    let of = |values: &[f64], run: usize, at: usize| values[at..at + rows.count[run] as usize].to_vec();
    if let &[(run, at)] = own {
        let end = at + rows.count[run] as usize;
        return part::put(body, &runs, rows.columns.map(|values| &values[at..end]));
    }
    let joined = rows.columns.map(|values| own.iter().flat_map(|&(run, at)| of(values, run, at)).collect::<Vec<_>>());
    part::put(body, &runs, [&joined[0], &joined[1], &joined[2]])
}

/// A pack's beginning.
fn head(areas: &[(u32, usize)]) -> Vec<u8> {
    let mut index = Vec::with_capacity(4 + 4 * areas.len());
    put_number(&mut index, areas.len() as u64);
    let mut next = 0;
    for &(point, length) in areas {
        put_number(&mut index, u64::from(point) - next);
        put_number(&mut index, length as u64);
        next = u64::from(point) + 1;
    }
    let size: usize = areas.iter().map(|&(_, length)| length).sum();
    let mut out = Vec::with_capacity(12 + index.len() + size);
    out.extend_from_slice(&MAGIC);
    out.extend_from_slice(&crc32fast::hash(&index).to_le_bytes());
    out.extend_from_slice(&(index.len() as u32).to_le_bytes());
    out.extend_from_slice(&index);
    out
}

/// The points of a pack with the bytes of their parts, which are not looked at.
fn areas(pack: &[u8]) -> Result<Areas<'_>, Fault> {
    let mut reader = Reader(pack);
    if reader.array()? != MAGIC {
        return Err(Fault::Number);
    }
    let sum = u32::from_le_bytes(reader.array()?);
    let length = u32::from_le_bytes(reader.array()?) as usize;
    let index = reader.take(length)?;
    if crc32fast::hash(index) != sum {
        return Err(Fault::Checksum);
    }
    let mut index = Reader(index);
    let (count, mut found, mut next) = (index.length()?, Vec::new(), 0u64);
    for _ in 0..count {
        let point =
            next.checked_add(index.number()?).and_then(|point| u32::try_from(point).ok()).ok_or(Fault::Number)?;
        found.push((point, reader.take(index.length()?)?));
        next = u64::from(point) + 1;
    }
    if index.0.is_empty() && reader.0.is_empty() { Ok(found) } else { Err(Fault::Length) }
}

/// The points of a pack, each with its rows' span.
pub fn index(pack: &[u8]) -> Result<Vec<(u32, Span)>, Fault> {
    areas(pack)?.into_iter().map(|(point, area)| Ok((point, span_of(area)?))).collect()
}

fn span_of(area: &[u8]) -> Result<Span, Fault> {
    let spans = parts(area).map(|part| part?.span());
    spans.reduce(|a, b| Ok(a?.and(b?))).unwrap_or(Err(Fault::Length))
}

/// A pack of one point's parts of a pack alone; None where it has none of them.
pub fn only(pack: &[u8], point: u32) -> Result<Option<Vec<u8>>, Fault> {
    let found = areas(pack)?.into_iter().find(|&(one, _)| one == point);
    Ok(found.map(|(_, area)| alone(point, area)))
}

fn alone(point: u32, area: &[u8]) -> Vec<u8> {
    let mut out = head(&[(point, area.len())]);
    out.extend_from_slice(area);
    out
}

/// One pack of many, in the order of time. Parts that begin at or before `after_ns` of their point are left out.
pub fn join(packs: &[&[u8]], after_ns: impl Fn(u32) -> i64) -> Result<Vec<u8>, Fault> {
    let mut kept: Areas<'_> = Vec::new();
    for pack in packs {
        for (point, area) in areas(pack)? {
            let after_ns = after_ns(point);
            for part in parts(area) {
                let part = part?;
                if part.span()?.first_ns > after_ns {
                    kept.push((point, part.whole));
                }
            }
        }
    }
    kept.sort_by_key(|&(point, _)| point);
    let points = kept.chunk_by(|a, b| a.0 == b.0);
    let mut out = head(&points.map(|own| (own[0].0, own.iter().map(|one| one.1.len()).sum())).collect::<Vec<_>>());
    kept.iter().for_each(|(_, part)| out.extend_from_slice(part));
    Ok(out)
}

/// All rows of a pack, by point; velocity: whether that is wanted as well.
pub fn decode(pack: &[u8], velocity: bool) -> Result<Rows, Fault> {
    let mut rows = Rows::default();
    for (point, area) in areas(pack)? {
        for part in parts(area) {
            part?.read(point, velocity, &mut rows)?;
        }
    }
    Ok(rows)
}

/// What is kept of one point's rows.
#[derive(Clone, Debug)]
pub struct Block {
    /// Number of the point in its group.
    pub point: u32,
    /// When its rows are, and how many.
    pub span: Span,
    /// Least displacement of rows that are not lost, m; not a number without any.
    pub low: f64,
    /// Largest one.
    pub high: f64,
    /// Its seconds, [`super::ENTRY_BYTES`] each.
    pub seconds: Vec<u8>,
    /// A pack of its rows alone.
    pub pack: Vec<u8>,
}

/// The block of each point of a pack.
pub fn blocks(pack: &[u8]) -> Result<Vec<Block>, Fault> {
    let block = |(point, area): (u32, &[u8])| {
        let mut rows = Rows::default();
        for part in parts(area) {
            part?.read(point, false, &mut rows)?;
        }
        let (seconds, low, high) = seconds(&rows);
        Ok(Block { point, span: span_of(area)?, low, high, seconds, pack: alone(point, area) })
    };
    areas(pack)?.into_iter().map(block).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn view(rows: &Rows) -> RowsRef<'_> {
        let [displacement, std, velocity] = &rows.columns;
        RowsRef {
            point: &rows.point,
            t0_ns: &rows.t0_ns,
            dt_ns: &rows.dt_ns,
            count: &rows.count,
            status: &rows.status,
            columns: [displacement, std, velocity],
        }
    }

    /// A second of some points: two runs of each.
    fn second(number: i64, points: &[u32]) -> Rows {
        let mut rows = Rows::default();
        for &point in points {
            for run in 0..2 {
                rows.point.push(point);
                rows.t0_ns.push(number * SECOND_NS + run * SECOND_NS / 2);
                rows.dt_ns.push(SECOND_NS / 20);
                rows.count.push(10);
                rows.status.push(run as u8);
                for k in 0..10 {
                    let phase = f64::from(point) + number as f64 + 0.05 * (10 * run + k) as f64;
                    rows.columns[0].push((1e5 * phase.sin()).round() * 2f64.powi(-30));
                    rows.columns[1].push(2f64.powi(-12));
                    rows.columns[2].push((1e5 * phase.cos()).round() * 2f64.powi(-28));
                }
            }
        }
        rows
    }

    const SECOND_NS: i64 = 1_000_000_000;

    #[test]
    fn packs_joined_are_their_rows_by_point() {
        let packs: Vec<Vec<u8>> = [&[3, 7][..], &[7], &[1, 3, 7]]
            .iter()
            .enumerate()
            .map(|(number, points)| encode(view(&second(number as i64, points))).unwrap())
            .collect();
        let views: Vec<&[u8]> = packs.iter().map(Vec::as_slice).collect();
        let whole = join(&views, |_| i64::MIN).unwrap();
        for point in [1, 3, 7] {
            let mut expected = Vec::new();
            for pack in &packs {
                if let Some(own) = only(pack, point).unwrap() {
                    expected.extend(decode(&own, true).unwrap().columns[0].clone());
                }
            }
            let own = decode(&only(&whole, point).unwrap().unwrap(), true).unwrap();
            assert_eq!(own.columns[0], expected);
            assert!(own.point.iter().all(|&one| one == point));
        }
        assert_eq!(only(&whole, 2).unwrap(), None);
        let later = join(&views, |point| if point == 7 { 0 } else { i64::MIN }).unwrap();
        let spans = index(&later).unwrap();
        assert_eq!(spans.iter().map(|one| one.0).collect::<Vec<_>>(), [1, 3, 7]);
        assert_eq!((spans[2].1.first_ns, spans[2].1.rows), (SECOND_NS, 40));
    }

    #[test]
    fn rows_that_do_not_follow_each_other_are_refused() {
        let mut rows = second(0, &[1]);
        rows.t0_ns[1] = 0;
        assert_eq!(encode(view(&rows)), Err(Fault::Runs));
        rows = second(0, &[1]);
        rows.columns[2].pop();
        assert_eq!(encode(view(&rows)), Err(Fault::Runs));
    }

    proptest! {
        #[test]
        fn a_damaged_byte_is_an_error(place in any::<usize>(), bit in 0..8u32) {
            let mut pack = encode(view(&second(5, &[1, 4, 9]))).unwrap();
            let place = place % pack.len();
            pack[place] ^= 1 << bit;
            prop_assert!(decode(&pack, true).is_err());
            prop_assert!(join(&[&pack], |_| i64::MIN).is_err());
        }

        #[test]
        fn other_bytes_are_an_error(data in prop::collection::vec(any::<u8>(), 0..200)) {
            prop_assert!(decode(&data, true).is_err());
        }
    }
}
