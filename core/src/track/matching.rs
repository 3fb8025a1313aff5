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
/// Descriptors that one is compared with at a time.
const BLOCK: usize = 32;

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

/// The features of one kind, in blocks of this number: the first value of each of a block's features, then the second …
struct Kind {
    members: Vec<usize>,
    blocks: Vec<[f32; BLOCK]>,
}

impl Features {
    fn of_kind(&self, kind: i8) -> Kind {
        let members: Vec<usize> = (0..self.len()).filter(|&j| self.kinds[j] == kind).collect();
        let value =
            |part: &[usize], k: usize, l: usize| part.get(l).map_or(0.0, |j| self.descriptors[j * self.length + k]);
        let blocks = members
            .chunks(BLOCK)
            .flat_map(|part| (0..self.length).map(move |k| std::array::from_fn(|l| value(part, k, l))));
        Kind { blocks: blocks.collect(), members }
    }

    /// Calls `found` with the place of each feature, that of each other one of its kind, and the square of their
    /// distance.
    fn compare(&self, now: &Self, mut found: impl FnMut(usize, usize, f32)) {
        let mut kinds = self.kinds.clone();
        kinds.sort_unstable();
        kinds.dedup();
        for kind in kinds {
            let others = now.of_kind(kind);
            for i in (0..self.len()).filter(|&i| self.kinds[i] == kind) {
                let one = &self.descriptors[i * self.length..][..self.length];
                for (block, members) in others.blocks.chunks(self.length).zip(others.members.chunks(BLOCK)) {
                    members.iter().zip(squares(one, block)).for_each(|(&j, square)| found(i, j, square));
                }
            }
        }
    }
}

vectorised! {
/// Squared distances of a descriptor to a block of others.
fn squares(one: &[f32], block: &[[f32; BLOCK]]) -> [f32; BLOCK] {
    let mut sums = [0f32; BLOCK];
    for (value, others) in one.iter().zip(block) {
        for (sum, other) in sums.iter_mut().zip(others) {
            let difference = value - other;
            *sum += difference * difference;
        }
    }
    sums
}
}

/// Matches of two sets, as places in them: features that are each other's nearest; none of fewer than two features.
pub fn mutual(first: &Features, now: &Features) -> Vec<[usize; 2]> {
    if !first.can_match(now) {
        return Vec::new();
    }
    let mut nearest_first = vec![(FAR, usize::MAX); now.len()];
    let mut nearest_now = vec![(FAR, usize::MAX); first.len()];
    first.compare(now, |i, j, square| {
        if square < nearest_now[i].0 {
            nearest_now[i] = (square, j);
        }
        if square < nearest_first[j].0 {
            nearest_first[j] = (square, i);
        }
    });
    let pairs = nearest_now.into_iter().enumerate();
    pairs.filter(|&(i, (_, j))| nearest_first.get(j).is_some_and(|one| one.1 == i)).map(|(i, (_, j))| [i, j]).collect()
}

/// Matches of each feature whose nearest one is nearer than `ratio` times the second nearest.
pub fn by_ratio(first: &Features, now: &Features, ratio: f64) -> Vec<[usize; 2]> {
    if !first.can_match(now) {
        return Vec::new();
    }
    let mut nearest = vec![(FAR, usize::MAX, FAR); first.len()];
    first.compare(now, |i, j, square| {
        let (least, _, second) = nearest[i];
        if square < least {
            nearest[i] = (square, j, least);
        } else if square < second {
            nearest[i].2 = square;
        }
    });
    let clear = |least: f32, second: f32| f64::from(least) < ratio * ratio * f64::from(second);
    let matches =
        nearest.into_iter().enumerate().filter(|(_, (least, j, second))| *j != usize::MAX && clear(*least, *second));
    matches.map(|(i, (_, j, _))| [i, j]).collect()
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
        let [one, other] = [one, other].map(|values| Features::new(values, 61, vec![0]).unwrap());
        let mut found = Vec::new();
        on_both(|| squares(&one.descriptors, &other.of_kind(0).blocks)[0]);
        one.compare(&other, |i, j, square| found.push((i, j, square)));
        assert_eq!(found, [(0, 0, 244.0)]);
    }
}
