//! Sums of products of a frame's pixels with kernels of 8 bits: exact for bytes, in single precision for other pixels.

use super::vector::{WIDE_LANES as LANES, is_wide};

/// Half as many sums as lanes: those of neighbouring columns are one.
pub const PAIRS: usize = LANES / 2;

/// A number that is multiplied with kernels of 8 bits.
pub trait Factor: Copy + Default {
    /// The products of lines of pixels with those of each kernel, summed over the lines and over each pair of columns;
    /// of the kernels' lines each `step`th is used.
    fn products<const N: usize>(
        lines: &[[Self; LANES]],
        kernels: &[[[i8; LANES]; N]],
        step: usize,
    ) -> [[f32; PAIRS]; N];
}

impl Factor for i16 {
    #[inline(always)]
    fn products<const N: usize>(
        lines: &[[i16; LANES]],
        kernels: &[[[i8; LANES]; N]],
        step: usize,
    ) -> [[f32; PAIRS]; N] {
        #[cfg(target_arch = "x86_64")]
        if is_wide() {
            // SAFETY: the processor has AVX2.
            return unsafe { wide_products(lines, kernels, step) };
        }
        let mut sums = [[0i32; PAIRS]; N];
        for (line, kernels) in lines.iter().zip(kernels.iter().step_by(step)) {
            for (sums, kernel) in sums.iter_mut().zip(kernels) {
                for c in 0..PAIRS {
                    sums[c] += i32::from(line[2 * c]) * i32::from(kernel[2 * c])
                        + i32::from(line[2 * c + 1]) * i32::from(kernel[2 * c + 1]);
                }
            }
        }
        sums.map(|sums| sums.map(|sum| sum as f32))
    }
}

/// The products of [`Factor`] for whole numbers, by the one instruction that multiplies 16 of them and adds neighbours,
/// which the compiler does not find: the same sums, bit for bit.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
unsafe fn wide_products<const N: usize>(
    lines: &[[i16; LANES]],
    kernels: &[[[i8; LANES]; N]],
    step: usize,
) -> [[f32; PAIRS]; N] {
    use std::arch::x86_64::{
        _mm_loadu_si128, _mm256_add_epi32, _mm256_cvtepi8_epi16, _mm256_cvtepi32_ps, _mm256_loadu_si256,
        _mm256_madd_epi16, _mm256_setzero_si256, _mm256_storeu_ps,
    };
    let mut out = [[0.0f32; PAIRS]; N];
    // SAFETY: every load and store is of an array of its size.
    unsafe {
        let mut sums = [_mm256_setzero_si256(); N];
        for (line, kernels) in lines.iter().zip(kernels.iter().step_by(step)) {
            let line = _mm256_loadu_si256(line.as_ptr().cast());
            for (sum, kernel) in sums.iter_mut().zip(kernels) {
                let kernel = _mm256_cvtepi8_epi16(_mm_loadu_si128(kernel.as_ptr().cast()));
                *sum = _mm256_add_epi32(*sum, _mm256_madd_epi16(line, kernel));
            }
        }
        for (out, sum) in out.iter_mut().zip(sums) {
            _mm256_storeu_ps(out.as_mut_ptr(), _mm256_cvtepi32_ps(sum));
        }
    }
    out
}

impl Factor for f32 {
    #[inline(always)]
    fn products<const N: usize>(
        lines: &[[f32; LANES]],
        kernels: &[[[i8; LANES]; N]],
        step: usize,
    ) -> [[f32; PAIRS]; N] {
        let mut sums = [[0.0f32; LANES]; N];
        for (line, kernels) in lines.iter().zip(kernels.iter().step_by(step)) {
            for (sums, kernel) in sums.iter_mut().zip(kernels) {
                for c in 0..LANES {
                    sums[c] += line[c] * f32::from(kernel[c]);
                }
            }
        }
        sums.map(|sums| std::array::from_fn(|c| sums[2 * c] + sums[2 * c + 1]))
    }
}
