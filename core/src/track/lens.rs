//! The two lens models of OpenCV: where a ray falls on the picture, and back, with derivatives.
//!
//! Rays are (x, y) on the plane at distance 1 before the camera; the lens moves them to (x, y) as a picture shows them.
//! Pinhole: k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4, rational radial terms, tangential terms and thin prism (Weng, Cohen
//! and Herniou 1992, doi 10.1109/34.159901). Fisheye: k1 … k4 (Kannala and Brandt 2006, doi 10.1109/TPAMI.2006.153).

/// Where Newton's steps end, of the plane's unit.
const CLOSE: f64 = 1e-13;
const RADIAL_STEPS: usize = 100;
const PLANE_STEPS: usize = 20;
/// Below this radius a fisheye is its series.
const NEAR_AXIS: f64 = 1e-6;

/// What the lens does to a ray.
#[derive(Clone, Copy, Debug)]
pub enum Model {
    /// Rational radial terms, tangential terms and thin prism.
    Pinhole([f64; 12]),
    /// A polynomial of the angle to the axis.
    Fisheye([f64; 4]),
}

/// A camera's lens.
#[derive(Clone, Copy, Debug)]
pub struct Lens {
    /// Focal lengths along x and y, px.
    pub focal: [f64; 2],
    /// Principal point, px.
    pub centre: [f64; 2],
    /// What it does to a ray.
    pub model: Model,
    /// Largest distance of a ray from the axis up to which the model is unique.
    pub limit: f64,
}

/// A place with its derivatives: rows by the place's axes, columns by those of what it was made from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mapped {
    /// x and y.
    pub place: [f64; 2],
    /// Of x by x and y, of y by x and y.
    pub slope: [[f64; 2]; 2],
}

impl Lens {
    /// A place of the picture, px, in an ideal pinhole picture; None where the model has none.
    pub fn straight(&self, place: [f64; 2]) -> Option<Mapped> {
        let ray = self.ray([0, 1].map(|k| (place[k] - self.centre[k]) / self.focal[k]))?;
        let [[xx, xy], [yx, yy]] = self.bent(ray).slope;
        let area = xx * yy - xy * yx;
        let aspect = self.focal[0] / self.focal[1];
        Some(Mapped {
            place: [0, 1].map(|k| self.focal[k] * ray[k] + self.centre[k]),
            slope: [[yy / area, -xy / area * aspect], [-yx / area / aspect, xx / area]],
        })
    }

    /// A place of an ideal pinhole picture, px, where the real one shows it; None where the model has none.
    pub fn shown(&self, place: [f64; 2]) -> Option<Mapped> {
        let ray = [0, 1].map(|k| (place[k] - self.centre[k]) / self.focal[k]);
        if !ray[0].hypot(ray[1]).le(&self.limit) {
            return None;
        }
        let Mapped { place, slope: [[xx, xy], [yx, yy]] } = self.bent(ray);
        let aspect = self.focal[0] / self.focal[1];
        let place = [0, 1].map(|k| self.focal[k] * place[k] + self.centre[k]);
        Some(Mapped { place, slope: [[xx, xy * aspect], [yx / aspect, yy]] })
    }

    /// Radius on the picture over radius of the ray, and its slope divided by the radius.
    fn radial(&self, r: f64) -> [f64; 2] {
        match self.model {
            Model::Fisheye(k) if r < NEAR_AXIS => [1.0 + (k[0] - 1.0 / 3.0) * r * r, 2.0 * (k[0] - 1.0 / 3.0)],
            Model::Fisheye(k) => {
                let angle = r.atan();
                let u = angle * angle;
                let bent = angle * (1.0 + u * (k[0] + u * (k[1] + u * (k[2] + u * k[3]))));
                let slope = 1.0 + u * (3.0 * k[0] + u * (5.0 * k[1] + u * (7.0 * k[2] + u * 9.0 * k[3])));
                let factor = bent / r;
                [factor, (slope / (1.0 + r * r) - factor) / (r * r)]
            }
            Model::Pinhole(k) => {
                let u = r * r;
                let above = 1.0 + u * (k[0] + u * (k[1] + u * k[4]));
                let below = 1.0 + u * (k[5] + u * (k[6] + u * k[7]));
                let above_slope = k[0] + u * (2.0 * k[1] + 3.0 * u * k[4]);
                let below_slope = k[5] + u * (2.0 * k[6] + 3.0 * u * k[7]);
                [above / below, 2.0 * (above_slope * below - above * below_slope) / (below * below)]
            }
        }
    }

    /// Where a ray falls.
    fn bent(&self, [x, y]: [f64; 2]) -> Mapped {
        let u = x * x + y * y;
        let [factor, slope] = self.radial(u.sqrt());
        let (xx, xy, yy) = (factor + slope * x * x, slope * x * y, factor + slope * y * y);
        let Model::Pinhole([_, _, p1, p2, _, _, _, _, s1, s2, s3, s4]) = self.model else {
            return Mapped { place: [x * factor, y * factor], slope: [[xx, xy], [xy, yy]] };
        };
        let (prism_x, prism_y) = (s1 + 2.0 * s2 * u, s3 + 2.0 * s4 * u);
        let across = xy + 2.0 * p1 * x + 2.0 * p2 * y;
        Mapped {
            place: [
                x * factor + 2.0 * p1 * x * y + p2 * (u + 2.0 * x * x) + u * (s1 + s2 * u),
                y * factor + p1 * (u + 2.0 * y * y) + 2.0 * p2 * x * y + u * (s3 + s4 * u),
            ],
            slope: [
                [xx + 2.0 * p1 * y + 6.0 * p2 * x + 2.0 * prism_x * x, across + 2.0 * prism_x * y],
                [across + 2.0 * prism_y * x, yy + 6.0 * p1 * y + 2.0 * p2 * x + 2.0 * prism_y * y],
            ],
        }
    }

    /// The radius whose image is `target`, by Newton's steps kept inside a shrinking bracket; None where there is none.
    fn ray_radius(&self, target: f64) -> Option<f64> {
        if !target.le(&(self.limit * self.radial(self.limit)[0])) {
            return None;
        }
        let (mut low, mut high, mut r) = (0.0, self.limit, target.min(self.limit));
        for _ in 0..RADIAL_STEPS {
            let [factor, slope] = self.radial(r);
            let off = r * factor - target;
            if off.abs() <= CLOSE * (1.0 + target) {
                break;
            }
            if off > 0.0 {
                high = r;
            } else {
                low = r;
            }
            let steepness = factor + slope * r * r;
            let next = if steepness > 0.0 { r - off / steepness } else { 0.5 * (low + high) };
            r = if low < next && next < high { next } else { 0.5 * (low + high) };
        }
        Some(r)
    }

    /// The ray that falls on a place; None where the model has none.
    ///
    /// The radial part is solved alone first; the small rest (tangential, prism) by Newton's method in the plane.
    fn ray(&self, [x, y]: [f64; 2]) -> Option<[f64; 2]> {
        let radius = x.hypot(y);
        let r = self.ray_radius(radius)?;
        let mut ray = if radius > 0.0 { [x * r / radius, y * r / radius] } else { [0.0; 2] };
        for _ in 0..PLANE_STEPS {
            let Mapped { place, slope: [[xx, xy], [yx, yy]] } = self.bent(ray);
            let (off_x, off_y, area) = (place[0] - x, place[1] - y, xx * yy - xy * yx);
            if area.is_nan() || area <= 0.0 || ray[0].hypot(ray[1]) > self.limit {
                return None;
            }
            if off_x.abs() + off_y.abs() <= CLOSE * (1.0 + radius) {
                return Some(ray);
            }
            ray[0] -= (yy * off_x - xy * off_y) / area;
            ray[1] -= (xx * off_y - yx * off_x) / area;
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const PINHOLE: Model = Model::Pinhole([-0.3, 0.1, 0.001, -0.002, 0.0, 0.02, 0.0, 0.0, 0.003, -0.001, 0.002, 0.001]);
    const FISHEYE: Model = Model::Fisheye([0.03, -0.01, 0.002, 0.0]);

    fn lens(model: Model) -> Lens {
        Lens { focal: [500.0, 520.0], centre: [319.0, 241.0], model, limit: 0.9 }
    }

    proptest! {
        #[test]
        fn there_and_back_is_the_same_place_with_inverse_derivatives(x in 70.0..570.0f64, y in 40.0..440.0f64) {
            for model in [PINHOLE, FISHEYE] {
                let there = lens(model).straight([x, y]).unwrap();
                let back = lens(model).shown(there.place).unwrap();
                prop_assert!((back.place[0] - x).abs() < 1e-9 && (back.place[1] - y).abs() < 1e-9);
                for (i, row) in there.slope.iter().enumerate() {
                    for j in 0..2 {
                        let product = row[0] * back.slope[0][j] + row[1] * back.slope[1][j];
                        prop_assert!((product - f64::from(u8::from(i == j))).abs() < 1e-9);
                    }
                }
                let step = 1e-4;
                let ahead = lens(model).straight([x + step, y]).unwrap().place;
                // A one-sided difference of 1e-4 px errs by the curvature, 1e-3 / px.
                prop_assert!(((ahead[0] - there.place[0]) / step - there.slope[0][0]).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn beyond_the_limit_and_of_no_number_there_is_no_place() {
        for model in [PINHOLE, FISHEYE] {
            assert_eq!(lens(model).shown([319.0 + 500.0, 241.0]), None);
            assert_eq!(lens(model).straight([2000.0, 241.0]), None);
            assert_eq!(lens(model).straight([f64::NAN, 241.0]), None);
            assert_eq!(lens(model).straight([319.0, 241.0]).unwrap().place, [319.0, 241.0]);
        }
    }
}
