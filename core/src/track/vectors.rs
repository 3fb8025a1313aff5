//! Loops that the processor takes several numbers at once in: compiled for AVX2 where it has that, and for every other.
//!
//! Sums run in a fixed number of lanes, so that both give the same bits; nothing is contracted to fused products.

/// How many numbers a sum takes at once.
pub const LANES: usize = 16;

/// Whether loops may use AVX2.
#[inline(always)]
pub fn wide() -> bool {
    #[cfg(test)]
    if PORTABLE.with(std::cell::Cell::get) {
        return false;
    }
    #[cfg(target_arch = "x86_64")]
    return std::arch::is_x86_feature_detected!("avx2");
    #[cfg(not(target_arch = "x86_64"))]
    false
}

#[cfg(test)]
std::thread_local! {
    /// Whether a test wants what is compiled for every processor.
    pub static PORTABLE: std::cell::Cell<bool> = const { std::cell::Cell::new(false) };
}

/// What `work` gives with AVX2, where the processor has it, and without: these must be equal.
#[cfg(test)]
pub fn both_ways<R>(work: impl Fn() -> R) -> [R; 2] {
    let usual = work();
    PORTABLE.with(|portable| portable.set(true));
    let portable = work();
    PORTABLE.with(|portable| portable.set(false));
    [usual, portable]
}

/// Defines a function whose body is compiled twice, for AVX2 and for every processor; what it calls must be
/// `#[inline(always)]` to be so too. Loops in it are `for` loops: a closure that is not inlined is only compiled once.
macro_rules! vectorised {
    ($(#[$doc:meta])* $seen:vis fn $name:ident $(<$T:ident: $bound:path>)? ($($argument:ident: $type:ty),* $(,)?) $(-> $out:ty)? $body:block) => {
        $(#[$doc])*
        $seen fn $name $(<$T: $bound>)? ($($argument: $type),*) $(-> $out)? {
            #[inline(always)]
            fn plain $(<$T: $bound>)? ($($argument: $type),*) $(-> $out)? $body

            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx2")]
            unsafe fn wide $(<$T: $bound>)? ($($argument: $type),*) $(-> $out)? {
                plain($($argument),*)
            }

            #[cfg(target_arch = "x86_64")]
            if $crate::track::vectors::wide() {
                // SAFETY: the processor has AVX2.
                return unsafe { wide($($argument),*) };
            }
            plain($($argument),*)
        }
    };
}
pub(crate) use vectorised;

/// The lanes' sum, in pairs.
#[inline(always)]
pub fn gathered<const N: usize>(mut lanes: [f32; N]) -> f32 {
    let mut half = N / 2;
    while half > 0 {
        for k in 0..half {
            lanes[k] += lanes[k + half];
        }
        half /= 2;
    }
    lanes[0]
}

/// Sum of the products of two equally long slices.
#[inline(always)]
pub fn dot(one: &[f32], other: &[f32]) -> f32 {
    let mut lanes = [0.0f32; LANES];
    let (blocks, others) = (one.chunks_exact(LANES), other.chunks_exact(LANES));
    let (rest, rest_of_other) = (blocks.remainder(), others.remainder());
    for (a, b) in blocks.zip(others) {
        for k in 0..LANES {
            lanes[k] += a[k] * b[k];
        }
    }
    for (lane, (a, b)) in lanes.iter_mut().zip(rest.iter().zip(rest_of_other)) {
        *lane += a * b;
    }
    gathered(lanes)
}

/// The sum of a slice.
#[inline(always)]
pub fn sum(values: &[f32]) -> f32 {
    let mut lanes = [0.0f32; LANES];
    let blocks = values.chunks_exact(LANES);
    let rest = blocks.remainder();
    for a in blocks {
        for k in 0..LANES {
            lanes[k] += a[k];
        }
    }
    for (lane, a) in lanes.iter_mut().zip(rest) {
        *lane += a;
    }
    gathered(lanes)
}

/// Fill `out` with the sums of N lines, each times its weight; each line is at least as long as `out`.
#[inline(always)]
pub fn weighted<const N: usize>(lines: [&[f32]; N], weight: [f32; N], out: &mut [f32]) {
    let lines = lines.map(|line| &line[..out.len()]);
    for c in 0..out.len() {
        let mut total = weight[0] * lines[0][c];
        for j in 1..N {
            total += weight[j] * lines[j][c];
        }
        out[c] = total;
    }
}

/// Add to `out` the sums of N lines, each times its weight; each line is at least as long as `out`.
#[inline(always)]
pub fn add_weighted<const N: usize>(lines: [&[f32]; N], weight: [f32; N], out: &mut [f32]) {
    let lines = lines.map(|line| &line[..out.len()]);
    for c in 0..out.len() {
        let mut total = weight[0] * lines[0][c];
        for j in 1..N {
            total += weight[j] * lines[j][c];
        }
        out[c] += total;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    vectorised! {
        fn product(one: &[f32], other: &[f32]) -> f32 {
            dot(one, other)
        }
    }

    #[test]
    fn sums_are_the_same_bits_on_every_processor_and_right() {
        let one: Vec<f32> = (0..77).map(|k| (k as f32).sin()).collect();
        let other: Vec<f32> = (0..77).map(|k| (0.3 * k as f32).cos()).collect();
        let [usual, portable] = both_ways(|| product(&one, &other).to_bits());
        assert_eq!(usual, portable);
        let exact: f64 = one.iter().zip(&other).map(|(&a, &b)| f64::from(a) * f64::from(b)).sum();
        assert!((f64::from(f32::from_bits(usual)) - exact).abs() < 1e-5);
        assert!((sum(&one) - one.iter().sum::<f32>()).abs() < 1e-5);
    }
}
