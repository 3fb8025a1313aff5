//! A column of numbers: whole multiples of a power of two, of which differences are kept; other numbers as they are.

use super::Fault;
use super::bits::{MAX_RICE, Reader, RiceReader, put_number, put_rice, rice_bits, unzigzag, zigzag};

/// Differences of this order are kept at most: of an evenly timed smooth course the second ones are small.
const MAX_ORDER: usize = 3;
/// Whole numbers have this many bits at most.
const MAX_BITS: i32 = 61;
/// Of smaller numbers 2^exponent is no normal double.
const MIN_EXPONENT: i32 = -1000;

/// How a column is kept: the bits of its numbers, differences that are all zero, or as Rice codes.
const PLAIN: u8 = 0;
const CONSTANT: u8 = 1;
const RICE: u8 = 2;

/// Append a column, of which [`read`] makes each bit again.
pub fn put(out: &mut Vec<u8>, values: &[f64]) {
    let Some((exponent, whole)) = steps(values) else {
        out.push(PLAIN);
        values.iter().for_each(|value| out.extend_from_slice(&value.to_le_bytes()));
        return;
    };
    let (order, heads, rest) = differences(whole);
    let constant = rest.iter().all(|&value| value == 0);
    out.push(if constant { CONSTANT } else { RICE } | (order as u8) << 2);
    put_number(out, zigzag(i64::from(exponent)));
    heads[..order].iter().for_each(|&value| put_number(out, zigzag(value)));
    if !constant {
        let k = rice_parameter(&rest);
        out.push(k as u8);
        put_rice(out, rest.iter().map(|&value| zigzag(value)), k);
    }
}

/// Read `count` numbers onto the end of a column.
pub fn read<'a>(mut reader: Reader<'a>, count: usize, values: &mut Vec<f64>) -> Result<Reader<'a>, Fault> {
    let [head] = reader.array()?;
    let (kind, order) = (head & 3, usize::from(head >> 2));
    if kind == PLAIN && order == 0 {
        let bytes = reader.take(count.checked_mul(8).ok_or(Fault::Number)?)?;
        values.extend(
            bytes
                .chunks_exact(8)
                .map(|eight| f64::from_bits(eight.iter().rev().fold(0, |bits, &byte| bits << 8 | u64::from(byte)))),
        );
        return Ok(reader);
    }
    if !matches!(kind, CONSTANT | RICE) || order > MAX_ORDER {
        return Err(Fault::Number);
    }
    let exponent = i32::try_from(unzigzag(reader.number()?)).map_err(|_| Fault::Number)?;
    if !(MIN_EXPONENT..=1023).contains(&exponent) {
        return Err(Fault::Number);
    }
    let mut sums = [0; MAX_ORDER + 1];
    for sum in &mut sums[..order] {
        *sum = unzigzag(reader.number()?);
    }
    let step = f64::from_bits(((exponent + 1023) as u64) << 52);
    let coded = count.saturating_sub(order);
    if kind == CONSTANT {
        sum(values, count, order, sums, step, |_| Ok(0))?;
        return Ok(reader);
    }
    let [k] = reader.array()?;
    if u32::from(k) > MAX_RICE {
        return Err(Fault::Number);
    }
    let mut codes = RiceReader::new(reader, u32::from(k));
    sum(values, count, order, sums, step, |row| if row < coded { codes.next().map(unzigzag) } else { Ok(0) })?;
    codes.end()
}

/// Append what has these first values and differences: of order 0 the numbers themselves.
fn sum(
    values: &mut Vec<f64>,
    count: usize,
    order: usize,
    mut sums: [i64; MAX_ORDER + 1],
    step: f64,
    mut next: impl FnMut(usize) -> Result<i64, Fault>,
) -> Result<(), Fault> {
    for row in 0..count {
        sums[order] = next(row)?;
        values.push(sums[0] as f64 * step);
        for k in 0..order {
            sums[k] = sums[k].wrapping_add(sums[k + 1]);
        }
    }
    Ok(())
}

/// Numbers as multiples of the greatest power of two that they all are multiples of, and its exponent; None where some
/// are none: not finite, minus zero, or of too different sizes.
fn steps(values: &[f64]) -> Option<(i32, Vec<i64>)> {
    let (mut lowest, mut highest) = (i32::MAX, i32::MIN);
    for value in values.iter().map(|value| value.to_bits()).filter(|&bits| bits != 0) {
        let exponent = (value >> 52 & 0x7FF) as i32;
        if exponent == 0 || exponent == 0x7FF {
            return None;
        }
        lowest = lowest.min(exponent + (value | 1 << 52).trailing_zeros() as i32);
        highest = highest.max(exponent + 53);
    }
    if lowest == i32::MAX {
        return Some((0, vec![0; values.len()]));
    }
    if highest - lowest > MAX_BITS || lowest - 1075 < MIN_EXPONENT {
        return None;
    }
    let whole = |value: &f64| {
        let bits = value.to_bits();
        if bits == 0 {
            return 0;
        }
        let shift = (bits >> 52 & 0x7FF) as i32 - lowest;
        let mantissa = (bits & ((1 << 52) - 1) | 1 << 52) as i64;
        let size = if shift >= 0 { mantissa << shift } else { mantissa >> -shift };
        if bits >> 63 == 1 { -size } else { size }
    };
    Some((lowest - 1075, values.iter().map(whole).collect()))
}

/// The order of the differences that are smallest, the first value of each order below, and these differences.
fn differences(mut whole: Vec<i64>) -> (usize, [i64; MAX_ORDER], Vec<i64>) {
    let total = |values: &[i64]| values.iter().fold(0u64, |sum, &value| sum.saturating_add(zigzag(value)));
    let (mut best, mut least, mut heads) = (0, total(&whole), [0; MAX_ORDER]);
    let mut kept = whole.clone();
    for order in 1..=MAX_ORDER.min(whole.len().saturating_sub(1)) {
        heads[order - 1] = whole[0];
        for k in 1..whole.len() {
            whole[k - 1] = whole[k].wrapping_sub(whole[k - 1]);
        }
        whole.pop();
        let size = total(&whole);
        if size < least {
            (best, least) = (order, size);
            kept.clone_from(&whole);
        }
    }
    (best, heads, kept)
}

/// The parameter that needs the fewest bits: near the logarithm of the mean.
fn rice_parameter(values: &[i64]) -> u32 {
    let sum: u128 = values.iter().map(|&value| u128::from(zigzag(value))).sum();
    let mean = sum / values.len().max(1) as u128;
    let near = (128 - mean.leading_zeros()).min(MAX_RICE);
    let bits = |k: &u32| rice_bits(values.iter().map(|&value| zigzag(value)), *k);
    (near.saturating_sub(2)..=near).min_by_key(bits).unwrap_or(near)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn round_trip(values: &[f64]) -> usize {
        let mut out = Vec::new();
        put(&mut out, values);
        let length = out.len();
        out.extend_from_slice(b"after");
        let mut found = vec![1.0];
        let rest = read(Reader(&out), values.len(), &mut found).unwrap();
        assert_eq!(rest.0, b"after");
        let bits = |values: &[f64]| values.iter().map(|value| value.to_bits()).collect::<Vec<_>>();
        assert_eq!(bits(&found[1..]), bits(values));
        length
    }

    #[test]
    fn numbers_that_are_no_multiples_stay_as_they_are() {
        round_trip(&[f64::NAN, -0.0, f64::INFINITY, 1e300, 1e-310, 5e-324]);
        round_trip(&[1e300, 1e-300]);
        round_trip(&[f64::MAX, -f64::MAX]);
        round_trip(&[2f64.powi(60), 1.0, -(2f64.powi(60))]);
        round_trip(&[]);
    }

    #[test]
    fn a_constant_course_takes_a_few_bytes() {
        assert!(round_trip(&[0.125; 100]) <= 5);
        assert!(round_trip(&[0.0; 100]) <= 3);
    }

    proptest! {
        #[test]
        fn every_bit_comes_back(bits in prop::collection::vec(any::<u64>(), 0..40)) {
            round_trip(&bits.into_iter().map(f64::from_bits).collect::<Vec<_>>());
        }

        #[test]
        fn every_multiple_comes_back(
            whole in prop::collection::vec((0..60u32, any::<i64>()), 0..80), exponent in -200..200i32
        ) {
            let step = 2f64.powi(exponent);
            let values: Vec<f64> = whole.into_iter().map(|(shift, value)| (value >> shift) as f64 * step).collect();
            round_trip(&values);
        }

        #[test]
        fn other_bytes_are_an_error_or_numbers(data in prop::collection::vec(any::<u8>(), 0..60), count in 0..50usize) {
            let mut found = Vec::new();
            if read(Reader(&data), count, &mut found).is_ok() {
                prop_assert_eq!(found.len(), count);
            }
        }
    }
}
