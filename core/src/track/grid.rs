//! Two-dimensional arrays: values row after row.

/// Values (rows, columns).
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Grid<T = f32> {
    /// Row after row.
    pub values: Vec<T>,
    /// How many rows.
    pub rows: usize,
    /// How many columns.
    pub columns: usize,
}

/// A part of a window: its rows and columns from the first to before the last.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Part {
    /// First row.
    pub top: usize,
    /// Row after the last.
    pub bottom: usize,
    /// First column.
    pub left: usize,
    /// Column after the last.
    pub right: usize,
}

impl Part {
    /// How many rows.
    pub fn rows(&self) -> usize {
        self.bottom - self.top
    }

    /// How many columns.
    pub fn columns(&self) -> usize {
        self.right - self.left
    }

    /// How many pixels.
    pub fn size(&self) -> usize {
        self.rows() * self.columns()
    }
}

impl<T: Copy> Grid<T> {
    /// A grid of one value.
    pub fn filled(rows: usize, columns: usize, value: T) -> Self {
        Self { values: vec![value; rows * columns], rows, columns }
    }

    /// One row.
    #[inline(always)]
    pub fn row(&self, r: usize) -> &[T] {
        &self.values[r * self.columns..(r + 1) * self.columns]
    }

    /// One row, to be changed.
    #[inline(always)]
    pub fn row_mut(&mut self, r: usize) -> &mut [T] {
        &mut self.values[r * self.columns..(r + 1) * self.columns]
    }

    /// A copy of a part.
    pub fn part(&self, part: Part) -> Self {
        let mut values = Vec::with_capacity(part.size());
        (part.top..part.bottom).for_each(|r| values.extend_from_slice(&self.row(r)[part.left..part.right]));
        Self { values, rows: part.rows(), columns: part.columns() }
    }

    /// Each value changed.
    pub fn map<U>(&self, change: impl FnMut(&T) -> U) -> Grid<U> {
        Grid { values: self.values.iter().map(change).collect(), rows: self.rows, columns: self.columns }
    }

    /// Columns as rows.
    pub fn transposed(&self) -> Self {
        let mut values = Vec::with_capacity(self.values.len());
        for c in 0..self.columns {
            values.extend((0..self.rows).map(|r| self.values[r * self.columns + c]));
        }
        Self { values, rows: self.columns, columns: self.rows }
    }

    /// With `margin` more on every side, mirrored about the first and last value (which are not doubled).
    pub fn mirrored(&self, margin: usize) -> Self {
        let reflect = |k: usize, size: usize| {
            let period = 2 * (size.max(2) - 1);
            let k = (k + period * margin - margin) % period;
            if size == 1 { 0 } else { k.min(period - k) }
        };
        let (rows, columns) = (self.rows + 2 * margin, self.columns + 2 * margin);
        let across: Vec<usize> = (0..columns).map(|c| reflect(c, self.columns)).collect();
        let mut values = Vec::with_capacity(rows * columns);
        for r in 0..rows {
            let line = self.row(reflect(r, self.rows));
            values.extend(across.iter().map(|&c| line[c]));
        }
        Self { values, rows, columns }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_margin_mirrors_about_the_edge() {
        let grid = Grid { values: vec![1, 2, 3, 4, 5, 6], rows: 2, columns: 3 };
        let wide = grid.mirrored(3);
        assert_eq!(wide.row(3), [2, 3, 2, 1, 2, 3, 2, 1, 2]);
        assert_eq!(wide.row(2), wide.row(4));
        assert_eq!(grid.transposed().transposed(), grid);
    }
}
