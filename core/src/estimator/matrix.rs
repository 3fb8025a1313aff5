//! Small dense matrices of `f64` in one allocation.

use super::slow::Turn;
use serde::{Deserialize, Serialize};
use std::ops::{Index, IndexMut};

/// A matrix of rows of equal width.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Matrix {
    width: usize,
    data: Vec<f64>,
}

impl Matrix {
    /// Rows of zeros.
    pub fn zeros(rows: usize, width: usize) -> Self {
        Self { width, data: vec![0.0; rows * width] }
    }

    /// A square matrix with these elements on its diagonal.
    pub fn diagonal(elements: &[f64]) -> Self {
        let mut whole = Self::zeros(elements.len(), elements.len());
        for (i, &element) in elements.iter().enumerate() {
            whole[(i, i)] = element;
        }
        whole
    }

    /// Number of columns.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Number of rows.
    pub fn height(&self) -> usize {
        self.data.len().checked_div(self.width).unwrap_or(0)
    }

    /// A row.
    #[inline]
    pub fn row(&self, i: usize) -> &[f64] {
        &self.data[i * self.width..(i + 1) * self.width]
    }

    /// A row to change.
    #[inline]
    pub fn row_mut(&mut self, i: usize) -> &mut [f64] {
        &mut self.data[i * self.width..(i + 1) * self.width]
    }

    /// All elements, row by row.
    pub fn elements(&self) -> &[f64] {
        &self.data
    }

    /// All elements to change, row by row.
    pub fn elements_mut(&mut self) -> &mut [f64] {
        &mut self.data
    }

    /// Sets an element of a symmetric matrix and its mirror image.
    #[inline]
    pub fn set_both(&mut self, i: usize, j: usize, value: f64) {
        self[(i, j)] = value;
        self[(j, i)] = value;
    }

    /// Copies the elements of a matrix of the same shape.
    pub fn copy_from(&mut self, other: &Self) {
        self.width = other.width;
        self.data.clone_from(&other.data);
    }

    /// Row `to` becomes a copy of row `of`.
    pub fn copy_row(&mut self, of: usize, to: usize) {
        self.data.copy_within(of * self.width..(of + 1) * self.width, to * self.width);
    }

    /// Row and column `i` of a square matrix times a factor.
    pub fn scale_both(&mut self, i: usize, factor: f64) {
        for j in 0..self.width {
            self[(i, j)] *= factor;
            self[(j, i)] *= factor;
        }
    }

    /// Rows and columns `i` and `q` of a square matrix turned.
    pub fn turn_both(&mut self, (i, q): (usize, usize), turn: Turn) {
        for j in 0..self.width {
            (self[(i, j)], self[(q, j)]) = turn.of(self[(i, j)], self[(q, j)]);
        }
        for j in 0..self.width {
            (self[(j, i)], self[(j, q)]) = turn.of(self[(j, i)], self[(j, q)]);
        }
    }
}

impl Index<(usize, usize)> for Matrix {
    type Output = f64;

    #[inline]
    fn index(&self, (i, j): (usize, usize)) -> &f64 {
        &self.data[i * self.width + j]
    }
}

impl IndexMut<(usize, usize)> for Matrix {
    #[inline]
    fn index_mut(&mut self, (i, j): (usize, usize)) -> &mut f64 {
        &mut self.data[i * self.width + j]
    }
}

/// u' M u of a vector (k,) and a square matrix (k, k).
pub fn quadratic(u: &[f64], m: &Matrix) -> f64 {
    let mut total = 0.0;
    for (q, &one) in u.iter().enumerate() {
        for (&inner, &other) in m.row(q).iter().zip(u) {
            total += one * inner * other;
        }
    }
    total
}

/// Σ of the squares.
#[inline(always)]
pub fn squared(v: &[f64]) -> f64 {
    v.iter().map(|a| a * a).sum()
}
