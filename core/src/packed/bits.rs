//! Whole numbers of variable length (LEB128), of both signs (zigzag), as Rice codes; CRC-32 (IEEE 802.3).

use super::Fault;

/// A Rice code whose quotient has this many bits is followed by the whole number.
const ESCAPE: u32 = 24;
/// Largest parameter of a Rice code.
pub const MAX_RICE: u32 = 32;

/// Small numbers of both signs as small ones.
pub fn zigzag(value: i64) -> u64 {
    ((value << 1) ^ (value >> 63)) as u64
}

/// What [`zigzag`] made a number of.
pub fn unzigzag(value: u64) -> i64 {
    (value >> 1) as i64 ^ -((value & 1) as i64)
}

/// Append a number, seven bits a byte.
pub fn put_number(out: &mut Vec<u8>, mut value: u64) {
    while value >= 128 {
        out.push(value as u8 | 128);
        value >>= 7;
    }
    out.push(value as u8);
}

/// Bytes that are read from the front.
#[derive(Clone, Copy, Debug)]
pub struct Reader<'a>(pub &'a [u8]);

impl<'a> Reader<'a> {
    /// The next `count` bytes.
    pub fn take(&mut self, count: usize) -> Result<&'a [u8], Fault> {
        let (head, rest) = self.0.split_at_checked(count).ok_or(Fault::Length)?;
        self.0 = rest;
        Ok(head)
    }

    /// The next `N` bytes.
    pub fn array<const N: usize>(&mut self) -> Result<[u8; N], Fault> {
        self.take(N)?.try_into().map_err(|_| Fault::Length)
    }

    /// What [`put_number`] appended.
    pub fn number(&mut self) -> Result<u64, Fault> {
        let mut value = 0;
        for shift in (0..64).step_by(7) {
            let [byte] = self.array()?;
            value |= u64::from(byte & 127) << shift;
            if byte < 128 {
                return if shift == 63 && byte > 1 { Err(Fault::Number) } else { Ok(value) };
            }
        }
        Err(Fault::Number)
    }

    /// The same as a length or count.
    pub fn length(&mut self) -> Result<usize, Fault> {
        usize::try_from(self.number()?).map_err(|_| Fault::Number)
    }
}

/// Bits of Rice codes, the lowest of each byte first.
struct Bits<'a> {
    out: &'a mut Vec<u8>,
    word: u64,
    used: u32,
}

impl Bits<'_> {
    /// Append up to 32 bits.
    fn put(&mut self, value: u64, bits: u32) {
        self.word |= value << self.used;
        self.used += bits;
        if self.used >= 32 {
            self.out.extend_from_slice(&(self.word as u32).to_le_bytes());
            self.word >>= 32;
            self.used -= 32;
        }
    }
}

/// Append numbers as Rice codes of parameter `k`, up to a whole byte.
pub fn put_rice(out: &mut Vec<u8>, values: impl Iterator<Item = u64>, k: u32) {
    let mut bits = Bits { out, word: 0, used: 0 };
    for value in values {
        let quotient = value >> k;
        if quotient < u64::from(ESCAPE) {
            // As many ones as the quotient, and a zero.
            bits.put((1 << quotient) - 1, quotient as u32 + 1);
            bits.put(value & ((1 << k) - 1), k);
        } else {
            bits.put((1 << ESCAPE) - 1, ESCAPE);
            bits.put(value & 0xFFFF_FFFF, 32);
            bits.put(value >> 32, 32);
        }
    }
    let whole = bits.used.div_ceil(8) as usize;
    bits.out.extend_from_slice(&bits.word.to_le_bytes()[..whole]);
}

/// About how many bits [`put_rice`] needs.
pub fn rice_bits(values: impl Iterator<Item = u64>, k: u32) -> u64 {
    values.map(|value| u64::from(k) + 1 + (value >> k).min(u64::from(ESCAPE) + 64)).sum()
}

/// Reads Rice codes; [`RiceReader::end`] says where they end.
pub struct RiceReader<'a> {
    data: &'a [u8],
    at: usize,
    word: u64,
    used: u32,
    k: u32,
}

impl<'a> RiceReader<'a> {
    /// Codes of parameter `k` that begin where a reader is.
    pub fn new(reader: Reader<'a>, k: u32) -> Self {
        Self { data: reader.0, at: 0, word: 0, used: 0, k }
    }

    fn refill(&mut self) {
        if let Some(eight) = self.data.get(self.at..self.at + 8) {
            let next = eight.iter().rev().fold(0, |word, &byte| word << 8 | u64::from(byte));
            self.word |= next << self.used;
            let bytes = (63 - self.used) / 8;
            self.at += bytes as usize;
            self.used += 8 * bytes;
            return;
        }
        while self.used <= 55 && self.at < self.data.len() {
            self.word |= u64::from(self.data[self.at]) << self.used;
            self.at += 1;
            self.used += 8;
        }
    }

    fn bits(&mut self, count: u32) -> Result<u64, Fault> {
        if self.used < count {
            self.refill();
        }
        let value = self.word & ((1 << count) - 1);
        self.word >>= count;
        self.used = self.used.checked_sub(count).ok_or(Fault::Length)?;
        Ok(value)
    }

    /// The next number.
    pub fn next(&mut self) -> Result<u64, Fault> {
        if self.used < ESCAPE + 1 {
            self.refill();
        }
        let quotient = self.word.trailing_ones();
        if quotient < ESCAPE {
            self.bits(quotient + 1)?;
            return Ok(u64::from(quotient) << self.k | self.bits(self.k)?);
        }
        self.bits(ESCAPE)?;
        Ok(self.bits(32)? | self.bits(32)? << 32)
    }

    /// What follows the codes, of which the last byte may be filled with zeros.
    pub fn end(self) -> Result<Reader<'a>, Fault> {
        let at = self.at - (self.used / 8) as usize;
        self.data.get(at..).map(Reader).ok_or(Fault::Length)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn numbers_come_back(value in any::<u64>()) {
            let mut out = Vec::new();
            put_number(&mut out, value);
            let mut reader = Reader(&out);
            prop_assert_eq!(reader.number(), Ok(value));
            prop_assert!(reader.0.is_empty());
            prop_assert_eq!(zigzag(unzigzag(value)), value);
        }

        #[test]
        fn rice_codes_come_back(values in prop::collection::vec((0..64u32, any::<u64>()), 0..80), k in 0..=MAX_RICE) {
            let values: Vec<u64> = values.into_iter().map(|(shift, value)| value >> shift).collect();
            let mut out = Vec::new();
            put_rice(&mut out, values.iter().copied(), k);
            out.extend_from_slice(b"after");
            let mut reader = RiceReader::new(Reader(&out), k);
            for &value in &values {
                prop_assert_eq!(reader.next(), Ok(value));
            }
            prop_assert_eq!(reader.end().map(|rest| rest.0), Ok(&b"after"[..]));
        }
    }
}
