//! What histories draw of rows, for each second: least, largest and mean displacement, largest deviation, worst status.
//!
//! The figures and their bytes are those of `midspan.store.summary`.

use crate::rows::Rows;

/// A second: its number from the second in which the rows begin u16, status u8, rows u16, least, largest, mean and
/// deviation f32, the instants of least and largest in ns from its begin u32; little-endian.
pub const ENTRY_BYTES: usize = 29;
/// Rows of this status and above are lost, and have no figures.
const LOST: u8 = 2;
const SECOND_NS: i64 = 1_000_000_000;

/// Figures of a second.
struct Second {
    number: i64,
    status: u8,
    rows: u32,
    low: (f64, i64),
    high: (f64, i64),
    total: f64,
    std: f64,
}

impl Second {
    fn new(number: i64) -> Self {
        let (low, high) = ((f64::INFINITY, 0), (f64::NEG_INFINITY, 0));
        Self { number, status: 0, rows: 0, low, high, total: 0.0, std: f64::NEG_INFINITY }
    }

    fn add(&mut self, inside_ns: i64, value: f64, std: f64, status: u8) {
        self.status = self.status.max(status);
        if status >= LOST || !value.is_finite() {
            return;
        }
        self.rows += 1;
        self.total += value;
        if value < self.low.0 {
            self.low = (value, inside_ns);
        }
        if value > self.high.0 {
            self.high = (value, inside_ns);
        }
        if std.is_nan() || std > self.std {
            self.std = std;
        }
    }

    fn put(&self, out: &mut Vec<u8>) {
        let some = self.rows > 0;
        let figure = |value: f64| if some { value as f32 } else { 0.0 };
        out.extend_from_slice(&(self.number.clamp(0, 65_535) as u16).to_le_bytes());
        out.push(self.status);
        out.extend_from_slice(&(self.rows.min(65_535) as u16).to_le_bytes());
        for value in [self.low.0, self.high.0, self.total / f64::from(self.rows.max(1)), self.std] {
            out.extend_from_slice(&figure(value).to_le_bytes());
        }
        for inside_ns in [self.low.1, self.high.1] {
            out.extend_from_slice(&(inside_ns as u32).to_le_bytes());
        }
    }
}

/// The seconds of one point's rows as bytes, and least and largest displacement, not numbers where all rows are lost.
pub fn seconds(rows: &Rows) -> (Vec<u8>, f64, f64) {
    let origin = rows.t0_ns.first().map_or(0, |t0_ns| t0_ns.div_euclid(SECOND_NS));
    let (mut found, mut row) = (Vec::<Second>::new(), 0);
    for run in 0..rows.count.len() {
        for k in 0..i64::from(rows.count[run]) {
            let time_ns = rows.t0_ns[run] + k * rows.dt_ns[run];
            let number = time_ns.div_euclid(SECOND_NS) - origin;
            if found.last().is_none_or(|last| last.number != number) {
                found.push(Second::new(number));
            }
            if let Some(last) = found.last_mut() {
                let (value, std) = (rows.columns[0][row], rows.columns[1][row]);
                last.add(time_ns.rem_euclid(SECOND_NS), value, std, rows.status[run]);
            }
            row += 1;
        }
    }
    let mut out = Vec::with_capacity(found.len() * ENTRY_BYTES);
    found.iter().for_each(|one| one.put(&mut out));
    let some = found.iter().any(|one| one.rows > 0);
    let low = found.iter().map(|one| one.low.0).fold(f64::INFINITY, f64::min);
    let high = found.iter().map(|one| one.high.0).fold(f64::NEG_INFINITY, f64::max);
    if some { (out, low, high) } else { (out, f64::NAN, f64::NAN) }
}
