//! One mode of a beam under a force that is linear between even steps: x'' + 2ζω x' + ω² x = p, solved exactly.

/// What a step makes of the state and of the force at its ends.
pub struct Recurrence {
    /// Of displacement and velocity.
    pub transition: [[f64; 2]; 2],
    /// Of the force at the step's begin.
    pub load_now: [f64; 2],
    /// Of the force at its end.
    pub load_next: [f64; 2],
}

/// Displacement and velocity (n,) under a force (n,), at rest at the start.
pub fn respond(force: &[f64], recurrence: &Recurrence) -> Vec<[f64; 2]> {
    let Recurrence { transition, load_now, load_next } = recurrence;
    let mut state = [0.0; 2];
    let start = force.first().map(|_| state);
    let steps = force.windows(2).map(|force| {
        let [x, v] = state;
        state = [0, 1].map(|i: usize| {
            let driven = load_now[i] * force[0] + load_next[i] * force[1];
            transition[i][0] * x + transition[i][1] * v + driven
        });
        state
    });
    start.into_iter().chain(steps).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_free_mass_under_a_constant_force_follows_a_parabola() {
        let dt = 0.01;
        let transition = [[1.0, dt], [0.0, 1.0]];
        let recurrence =
            Recurrence { transition, load_now: [dt * dt / 3.0, dt / 2.0], load_next: [dt * dt / 6.0, dt / 2.0] };
        let states = respond(&[2.0; 101], &recurrence);
        // x = t², v = 2 t at 1 s.
        assert!((states[100][0] - 1.0).abs() < 1e-12 && (states[100][1] - 2.0).abs() < 1e-12);
        assert_eq!((states.len(), states[0]), (101, [0.0; 2]));
        assert!(respond(&[], &recurrence).is_empty());
    }
}
