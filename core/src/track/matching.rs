//! Matches of features by the nearest descriptor.

use super::vector::vectorised;

/// Features of an image: a descriptor of equal length and a kind of each.
pub struct Features {
    /// All values of the first feature, then of the next.
    descriptors: Vec<f32>,
    length: usize,
    /// Features of different kinds never match.
    kinds: Vec<i8>,
}

/// Squares beyond this are no distances of descriptors; of features of different kinds.
const FAR: f32 = 3.0e38;
const LANES: usize = 8;

impl Features {
    /// None where there are not as many descriptors of `length` values as kinds.
    pub fn new(descriptors: Vec<f32>, length: usize, kinds: Vec<i8>) -> Option<Self> {
        (length > 0 && descriptors.len() == length * kinds.len()).then_some(Self { descriptors, length, kinds })
    }

    /// How many features there are.
    pub fn len(&self) -> usize {
        self.kinds.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.kinds.is_empty()
    }

    fn can_match(&self, other: &Self) -> bool {
        self.len() >= 2 && other.len() >= 2 && self.length == other.length
    }
}

/// Matches of two sets, as places in them: features that are each other's nearest; none of fewer than two features.
pub fn mutual(first: &Features, now: &Features) -> Vec<[usize; 2]> {
    if !first.can_match(now) {
        return Vec::new();
    }
    let mut nearest_first = vec![(FAR, usize::MAX); now.len()];
    let nearest_now: Vec<(f32, usize)> = (0..first.len())
        .map(|i| {
            let mut nearest = (FAR, usize::MAX);
            for (j, square) in squares(first, i, now).into_iter().enumerate() {
                if square < nearest.0 {
                    nearest = (square, j);
                }
                if square < nearest_first[j].0 {
                    nearest_first[j] = (square, i);
                }
            }
            nearest
        })
        .collect();
    let pairs = nearest_now.into_iter().enumerate();
    pairs.filter(|&(i, (_, j))| nearest_first.get(j).is_some_and(|one| one.1 == i)).map(|(i, (_, j))| [i, j]).collect()
}

/// Matches of each feature whose nearest one is nearer than `ratio` times the second nearest.
pub fn by_ratio(first: &Features, now: &Features, ratio: f64) -> Vec<[usize; 2]> {
    if !first.can_match(now) {
        return Vec::new();
    }
    (0..first.len())
        .filter_map(|i| {
            let (mut nearest, mut second) = ((FAR, usize::MAX), FAR);
            for (j, square) in squares(first, i, now).into_iter().enumerate() {
                if square < nearest.0 {
                    (nearest, second) = ((square, j), nearest.0);
                } else if square < second {
                    second = square;
                }
            }
            let clear = f64::from(nearest.0) < ratio * ratio * f64::from(second);
            (clear && nearest.1 != usize::MAX).then_some([i, nearest.1])
        })
        .collect()
}

vectorised! {
/// Squared distances of one descriptor to all others.
fn squares(first: &Features, i: usize, now: &Features) -> Vec<f32> {
    let one = &first.descriptors[i * first.length..][..first.length];
    let kind = first.kinds[i];
    let others = now.descriptors.chunks_exact(first.length).zip(&now.kinds);
    others.map(|(other, &other_kind)| if other_kind == kind { square(one, other) } else { FAR }).collect()
}
}

#[inline(always)]
fn square(one: &[f32], other: &[f32]) -> f32 {
    let mut lanes = [0f32; LANES];
    let (one_parts, other_parts) = (one.chunks_exact(LANES), other.chunks_exact(LANES));
    let rest = one_parts.remainder().iter().zip(other_parts.remainder());
    for (one, other) in one_parts.zip(other_parts) {
        for l in 0..LANES {
            let difference = one[l] - other[l];
            lanes[l] += difference * difference;
        }
    }
    for (lane, (a, b)) in lanes.iter_mut().zip(rest) {
        *lane += (a - b) * (a - b);
    }
    let [a, b, c, d, e, f, g, h] = lanes;
    ((a + b) + (c + d)) + ((e + f) + (g + h))
}

#[cfg(test)]
mod tests {
    use super::super::vector::on_both;
    use super::*;

    fn features(rows: &[[f32; 2]], kinds: &[i8]) -> Features {
        Features::new(rows.as_flattened().to_vec(), 2, kinds.to_vec()).unwrap()
    }

    #[test]
    fn matches_are_mutual_nearest_neighbours_of_the_same_kind() {
        let first = features(&[[0.0, 0.0], [10.0, 0.0], [0.4, 0.0], [0.0, 20.0]], &[1, 1, 1, -1]);
        let now = features(&[[0.0, 20.5], [9.0, 0.0], [0.1, 0.0]], &[1, 1, 1]);
        // 0 and 2 both point to now[2], which is nearer to 0; 3 has no partner of its kind.
        assert_eq!(on_both(|| mutual(&first, &now)), [[0, 2], [1, 1]]);
        assert!(mutual(&first, &features(&[[0.0, 0.0]], &[1])).is_empty());
        let others = features(&[[0.0, 0.0], [1.0, 0.0]], &[0, 0]);
        assert!(mutual(&others, &now).is_empty() && by_ratio(&others, &now, 1.0).is_empty());
    }

    #[test]
    fn the_ratio_test_keeps_only_what_is_clearly_nearest() {
        let first = features(&[[0.0, 0.0], [10.0, 0.0]], &[0, 0]);
        let now = features(&[[0.0, 1.0], [0.0, 1.5], [10.0, 0.1]], &[0, 0, 0]);
        // 1.0 / 1.5 = 0.667 is above 0.65.
        assert_eq!(by_ratio(&first, &now, 0.65), [[1, 2]]);
        assert_eq!(by_ratio(&first, &now, 0.7), [[0, 0], [1, 2]]);
    }

    #[test]
    fn all_values_of_a_long_descriptor_count() {
        let one: Vec<f32> = (0..61).map(|k| k as f32).collect();
        let other: Vec<f32> = one.iter().map(|value| value + 2.0).collect();
        assert_eq!(square(&one, &other), 244.0);
    }
}
