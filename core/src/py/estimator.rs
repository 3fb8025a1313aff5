//! `estimator` for Python.

use super::elements;
use crate::estimator::lag::Lag;
use crate::estimator::matrix::Matrix;
use crate::estimator::model::instant;
use crate::estimator::reports::{Report, What};
use crate::estimator::rows::{AxisRows, Innovations, Rows};
use crate::estimator::run::Filter;
use crate::estimator::samples::View;
use crate::estimator::second_pass::smooth;
use crate::estimator::settings::{self, ParameterKind, Rates};
use crate::estimator::state::{StateError, from_bytes, to_bytes};
use crate::estimator::stream::{self, Limits, Output};
use crate::estimator::waiting::{Item, Measurement};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyBytes;

/// Displacement, variance, velocity, source and status (n,) of one axis.
type AxisArrays<'py> = (
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<u8>>,
    Bound<'py, PyArray1<u8>>,
);
/// Stamps (n,), and the rows of each axis.
type RowArrays<'py> = (Bound<'py, PyArray1<i64>>, Vec<AxisArrays<'py>>);
/// Stamps, values, variances and verdicts (m,) of one channel.
type InnovationArrays<'py> =
    (Bound<'py, PyArray1<i64>>, Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<i8>>);
/// What happened (see [`code`]): when (ns), to which channel, size (mm), its standard deviation (mm), of outliers in a row
/// how many and how long (s).
type ReportTuple = (u8, i64, usize, f64, f64, usize, f64);
/// Rows or None, innovations of each channel, events, variance of the zero of each axis.
type OutputTuple<'py> = (Option<RowArrays<'py>>, Vec<InnovationArrays<'py>>, Vec<ReportTuple>, Vec<f64>);

/// The settings as Python holds them.
#[derive(FromPyObject)]
struct PySettings {
    channels: Vec<PyChannel>,
    axes: usize,
    parameters: Vec<PyParameter>,
    bias_m_s2: Vec<f64>,
    bias_std_m_s2: Vec<f64>,
    bias_walk: f64,
    velocity_std_m_s: Option<Vec<f64>>,
    displacement_std_m: Option<f64>,
    rates: PyRates,
    noise_memory: f64,
    noise_weight: f64,
    motion: Vec<(f64, f64)>,
    zero_ns: Option<i64>,
    unseen_std_m: Vec<f64>,
    unseen_zero_std_m: Vec<f64>,
    misfit: Vec<f64>,
    lean: Vec<f64>,
}

#[derive(FromPyObject)]
struct PyChannel {
    sensor: String,
    source: u8,
    units_per_m: f64,
    axis: usize,
    variance_factor: f64,
    exposure_s: f64,
    zero_std_m: f64,
    zero_walk_m2_s: f64,
    coasting_s: f64,
    lost_s: f64,
    slow_std_m: f64,
    slow_time_s: f64,
}

#[derive(FromPyObject)]
struct PyParameter {
    kind: i64,
    channels: Vec<usize>,
    std: f64,
    estimated_from_ns: Option<i64>,
    walk: f64,
    clear: f64,
    axis: usize,
}

#[derive(FromPyObject)]
struct PyRates {
    outlier: f64,
    stays: f64,
    shift: f64,
    back: f64,
    wrong: f64,
    noise: f64,
    lost: f64,
    clock: f64,
    odds: f64,
}

impl PySettings {
    fn converted(self) -> PyResult<settings::Settings> {
        let mut sensors: Vec<String> = self.channels.iter().map(|one| one.sensor.clone()).collect();
        sensors.sort_unstable();
        sensors.dedup();
        let sensor = |name: &String| sensors.binary_search(name).unwrap_or(0);
        let channels = self.channels.iter().map(|one| one.converted(sensor(&one.sensor))).collect();
        let parameters = self.parameters.into_iter().map(PyParameter::converted).collect::<PyResult<_>>()?;
        let own = |std: &f64| if self.zero_ns.is_some() { std * std } else { 0.0 };
        let both = self.unseen_std_m.iter().zip(&self.unseen_zero_std_m);
        let rates = &self.rates;
        let settings = settings::Settings {
            channels,
            axes: self.axes,
            parameters,
            unseen_m2: both.clone().map(|(std, zero)| 2.0 * std * std + zero * zero).collect(),
            unseen_common_m2: both.map(|(std, zero)| own(std) + zero * zero).collect(),
            bias_m_s2: self.bias_m_s2,
            bias_std_m_s2: self.bias_std_m_s2,
            bias_walk: self.bias_walk,
            velocity_std_m_s: self.velocity_std_m_s,
            displacement_std_m: self.displacement_std_m,
            rates: Rates {
                outlier: rates.outlier,
                stays: rates.stays,
                shift: rates.shift,
                back: rates.back,
                wrong: rates.wrong,
                noise: rates.noise,
                lost: rates.lost,
                clock: rates.clock,
                odds: rates.odds,
            },
            noise_memory: self.noise_memory,
            noise_weight: self.noise_weight,
            motion: self.motion,
            zero_ns: self.zero_ns,
            misfit: self.misfit,
            lean: self.lean,
        };
        if settings.consistent() { Ok(settings) } else { Err(PyValueError::new_err("settings: inconsistent")) }
    }
}

impl PyChannel {
    fn converted(&self, sensor: usize) -> settings::Channel {
        settings::Channel {
            sensor,
            source: self.source,
            units_per_m: self.units_per_m,
            axis: self.axis,
            variance_factor: self.variance_factor,
            exposure_s: self.exposure_s,
            zero_std_m: self.zero_std_m,
            zero_walk_m2_s: self.zero_walk_m2_s,
            coasting_s: self.coasting_s,
            lost_s: self.lost_s,
            slow_std_m: self.slow_std_m,
            slow_time_s: self.slow_time_s,
        }
    }
}

impl PyParameter {
    fn converted(self) -> PyResult<settings::Parameter> {
        let kind = match self.kind {
            1 => ParameterKind::ScaleError,
            2 => ParameterKind::ClockOffset,
            -1 => ParameterKind::GainError { axis: self.axis },
            other => return Err(PyValueError::new_err(format!("kind of a parameter: {other}"))),
        };
        Ok(settings::Parameter {
            kind,
            channels: self.channels,
            std: self.std,
            estimated_from_ns: self.estimated_from_ns,
            walk: self.walk,
            clear: self.clear,
        })
    }
}

/// Why bytes are no state, as Python's error.
pub fn state_error(error: StateError) -> PyErr {
    PyValueError::new_err(match error {
        StateError::Damaged => "state: cut short or changed".to_owned(),
        StateError::OtherVersion(version) => format!("state: version {version}"),
        StateError::OtherSettings => "state: of other settings".to_owned(),
    })
}

/// The code of what is reported; Python words it.
fn code(what: What) -> u8 {
    match what {
        What::Late => 0,
        What::Overflow => 1,
        What::Rejected { .. } => 2,
        What::Wild => 3,
        What::Shifted => 4,
        What::Returned => 5,
        What::Wrong => 6,
        What::Lost => 7,
        What::Noise => 8,
        What::Clock => 9,
    }
}

fn report(one: &Report) -> ReportTuple {
    let (count, lasting_s) = match one.what {
        What::Rejected { count, lasting_s } => (count, lasting_s),
        _ => (0, 0.0),
    };
    (code(one.what), one.time_ns, one.channel, one.size_mm, one.std_mm, count, lasting_s)
}

fn axis_arrays<'py>(py: Python<'py>, one: AxisRows) -> AxisArrays<'py> {
    (
        one.displacement.into_pyarray(py),
        one.variance.into_pyarray(py),
        one.velocity.into_pyarray(py),
        one.source.into_pyarray(py),
        one.status.into_pyarray(py),
    )
}

fn row_arrays<'py>(py: Python<'py>, rows: Rows) -> RowArrays<'py> {
    (rows.time_ns.into_pyarray(py), rows.axes.into_iter().map(|one| axis_arrays(py, one)).collect())
}

fn innovation_arrays<'py>(py: Python<'py>, one: Innovations) -> InnovationArrays<'py> {
    (
        one.time_ns.into_pyarray(py),
        one.value.into_pyarray(py),
        one.variance.into_pyarray(py),
        one.verdict.into_pyarray(py),
    )
}

fn output_tuple<'py>(py: Python<'py>, one: Output) -> OutputTuple<'py> {
    (
        one.rows.map(|rows| row_arrays(py, rows)),
        one.innovations.into_iter().map(|own| innovation_arrays(py, own)).collect(),
        one.reports.iter().map(report).collect(),
        one.zero_variance,
    )
}

/// Samples of Python, checked: stamps (n,), values and densities (n, axes), kinds (n,).
struct PySamples<'py> {
    axes: usize,
    time_ns: PyReadonlyArray1<'py, i64>,
    value: PyReadonlyArray2<'py, f64>,
    density: PyReadonlyArray2<'py, f64>,
    kind: PyReadonlyArray1<'py, u8>,
}

impl PySamples<'_> {
    fn view(&self) -> PyResult<View<'_>> {
        let contiguous = |_| PyValueError::new_err("samples: not contiguous");
        let view = View {
            axes: self.axes,
            time_ns: elements("time_ns", &self.time_ns)?,
            value: self.value.as_slice().map_err(contiguous)?,
            density: self.density.as_slice().map_err(contiguous)?,
            kind: elements("kind", &self.kind)?,
        };
        let n = view.len();
        let shape = [n, self.axes];
        let (value, density) = (self.value.as_array(), self.density.as_array());
        if value.shape() != shape || density.shape() != shape || view.kind.len() != n {
            return Err(PyValueError::new_err(format!("samples: of other lengths, or not of {} axes", self.axes)));
        }
        if view.time_ns.windows(2).any(|two| two[1] <= two[0]) {
            return Err(PyValueError::new_err("time_ns: not increasing"));
        }
        Ok(view)
    }
}

/// Gives measurements to an estimator.
fn measure(
    own: &mut stream::Estimator,
    time_ns: &PyReadonlyArray1<'_, i64>,
    channel: &PyReadonlyArray1<'_, i64>,
    numbers: [&PyReadonlyArray1<'_, f64>; 3],
) -> PyResult<()> {
    let (stamps, channel) = (elements("time_ns", time_ns)?, elements("channel", channel)?);
    let count = own.settings().channels.len();
    if channel.iter().any(|&c| usize::try_from(c).map_or(true, |c| c >= count)) {
        return Err(PyValueError::new_err(format!("channel: there are {count}")));
    }
    let names = ["value", "variance", "reference_variance"];
    let [value, variance, reference] = [0, 1, 2].map(|i| elements(names[i], numbers[i]));
    let (value, variance, reference) = (value?, variance?, reference?);
    if [channel.len(), value.len(), variance.len(), reference.len()].iter().any(|&len| len != stamps.len()) {
        return Err(PyValueError::new_err("measurements: of other lengths"));
    }
    let rows = (0..stamps.len()).map(|i| Measurement {
        channel: usize::try_from(channel[i]).unwrap_or(0),
        value: value[i],
        variance: variance[i],
        reference: reference[i],
    });
    own.measure(stamps, rows);
    Ok(())
}

fn predict(own: &stream::Estimator, channel: usize, time_ns: i64) -> PyResult<Option<(f64, f64)>> {
    if channel >= own.settings().channels.len() {
        return Err(PyValueError::new_err(format!("channel: {channel}")));
    }
    Ok(own.predict(channel, time_ns))
}

fn matrix<'py>(py: Python<'py>, one: &Matrix) -> Bound<'py, PyArray2<f64>> {
    let rows: Vec<Vec<f64>> = (0..one.height()).map(|i| one.row(i).to_vec()).collect();
    PyArray2::from_vec2(py, &rows).unwrap_or_else(|_| PyArray2::zeros(py, [0, 0], false))
}

/// Time (s), states (n, 1 + k) and covariance (n, n).
type FilterArrays<'py> = (f64, Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<f64>>);

/// Parameters (k,) and their variances (k,).
type Parameters = (Vec<f64>, Vec<f64>);

fn parameters(own: &stream::Estimator) -> Parameters {
    match own.filter().map(|filter| filter.hyps.best()) {
        Some(best) => {
            let k = best.parameters.len();
            (best.parameters.clone(), (0..k).map(|q| best.spread[(q, q)]).collect())
        }
        None => {
            let stds = own.settings().parameters.iter();
            (vec![0.0; stds.len()], stds.map(|one| one.std * one.std).collect())
        }
    }
}

/// See [`stream::Estimator`].
#[pyclass(module = "midspan._core")]
struct Estimator {
    own: stream::Estimator,
}

#[pymethods]
impl Estimator {
    #[new]
    #[pyo3(signature = (settings, *, log, rows, waiting, block))]
    fn new(settings: PySettings, log: bool, rows: bool, waiting: usize, block: usize) -> PyResult<Self> {
        let limits = Limits { waiting: waiting.max(1), block: block.max(1) };
        Ok(Self { own: stream::Estimator::new(settings.converted()?, limits, log, rows) })
    }

    fn push<'py>(
        &mut self,
        py: Python<'py>,
        time_ns: PyReadonlyArray1<'py, i64>,
        value: PyReadonlyArray2<'py, f64>,
        density: PyReadonlyArray2<'py, f64>,
        kind: PyReadonlyArray1<'py, u8>,
    ) -> PyResult<Vec<OutputTuple<'py>>> {
        let samples = PySamples { axes: self.own.settings().axes, time_ns, value, density, kind };
        let (view, own) = (samples.view()?, &mut self.own);
        let outputs = py.detach(|| own.push(view));
        Ok(outputs.into_iter().map(|one| output_tuple(py, one)).collect())
    }

    fn measure(
        &mut self,
        time_ns: PyReadonlyArray1<'_, i64>,
        channel: PyReadonlyArray1<'_, i64>,
        value: PyReadonlyArray1<'_, f64>,
        variance: PyReadonlyArray1<'_, f64>,
        reference_variance: PyReadonlyArray1<'_, f64>,
    ) -> PyResult<()> {
        measure(&mut self.own, &time_ns, &channel, [&value, &variance, &reference_variance])
    }

    fn doubt(&mut self, time_ns: i64) {
        self.own.doubt(time_ns);
    }

    fn finish<'py>(&mut self, py: Python<'py>) -> Vec<OutputTuple<'py>> {
        let own = &mut self.own;
        let outputs = py.detach(|| own.finish());
        outputs.into_iter().map(|one| output_tuple(py, one)).collect()
    }

    fn predict(&self, channel: usize, time_ns: i64) -> PyResult<Option<(f64, f64)>> {
        predict(&self.own, channel, time_ns)
    }

    fn parameters(&self) -> Parameters {
        parameters(&self.own)
    }

    fn state<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        Ok(PyBytes::new(py, &to_bytes(self.own.memory()).map_err(state_error)?))
    }

    fn restore(&mut self, state: &[u8]) -> PyResult<()> {
        let memory = from_bytes(state).map_err(state_error)?;
        if self.own.restore(memory) { Ok(()) } else { Err(state_error(StateError::OtherSettings)) }
    }

    /// Times (s) and channels of what waits for samples, -1 for the datum and -2 for stamps that went back.
    fn waiting(&self) -> (Vec<f64>, Vec<i64>) {
        let channel = |item: &Item| match item {
            Item::Measured(one) => one.channel as i64,
            Item::Datum => -1,
            Item::WentBack => -2,
        };
        self.own.waiting().iter().map(|one| (one.at_s, channel(&one.item))).unzip()
    }

    /// How many measurements wait for the first sample.
    fn early(&self) -> usize {
        self.own.early()
    }

    /// Time (s), states (n, 1 + k) and covariance (n, n) of the best hypothesis; None before the filter has begun.
    fn filter<'py>(&self, py: Python<'py>) -> Option<FilterArrays<'py>> {
        let filter: &Filter = self.own.filter()?;
        let best = filter.hyps.best();
        Some((filter.clock.time_s, matrix(py, &best.x), matrix(py, &best.p)))
    }

    /// Whether there is a log.
    fn logs(&self) -> bool {
        self.own.log().is_some()
    }

    /// The rows of each axis, smoothed by the whole record that was logged.
    fn smooth<'py>(&self, py: Python<'py>, settings: PySettings, logged: bool) -> PyResult<RowArrays<'py>> {
        let settings = settings.converted()?;
        let log = self.own.log().ok_or_else(|| PyValueError::new_err("no log"))?;
        let known = self.own.settings();
        let same_table = settings.channels.len() == known.channels.len() && settings.axes == known.axes;
        if !same_table {
            return Err(PyValueError::new_err("settings: of other channels or axes"));
        }
        let logged = logged && settings.parameters.len() == known.parameters.len();
        let rows = py.detach(|| smooth(log, &settings, logged, self.own.block()));
        Ok(row_arrays(py, rows))
    }

    /// Stamps (k,) from which on clocks were in doubt in what was logged.
    fn went_back_ns(&self) -> Vec<i64> {
        let log = self.own.log();
        log.map_or_else(Vec::new, |log| log.went_back_s().iter().map(|&at_s| instant(at_s, log.origin_ns)).collect())
    }

    /// After how many samples the filter was logged.
    fn logged_filters(&self) -> Vec<usize> {
        self.own.log().map_or_else(Vec::new, |log| log.filters.keys().copied().collect())
    }

    /// Stamps (n,), values and densities (n · axes,) and kinds (n,) of what was logged.
    #[allow(clippy::type_complexity)]
    fn logged_samples<'py>(
        &self,
        py: Python<'py>,
    ) -> Option<(
        Bound<'py, PyArray1<i64>>,
        Bound<'py, PyArray1<f64>>,
        Bound<'py, PyArray1<f64>>,
        Bound<'py, PyArray1<u8>>,
    )> {
        let one = &self.own.log()?.samples;
        let (time_ns, kind) = (PyArray1::from_slice(py, &one.time_ns), PyArray1::from_slice(py, &one.kind));
        Some((time_ns, PyArray1::from_slice(py, &one.value), PyArray1::from_slice(py, &one.density), kind))
    }
}

/// See [`Lag`].
#[pyclass(module = "midspan._core", name = "Lag")]
struct PyLag {
    own: Lag,
}

#[pymethods]
impl PyLag {
    #[new]
    #[pyo3(signature = (settings, lag_samples, *, waiting, block))]
    fn new(settings: PySettings, lag_samples: usize, waiting: usize, block: usize) -> PyResult<Self> {
        let limits = Limits { waiting: waiting.max(1), block: block.max(1) };
        let estimator = stream::Estimator::new(settings.converted()?, limits, true, false);
        Ok(Self { own: Lag::new(estimator, lag_samples) })
    }

    fn push<'py>(
        &mut self,
        py: Python<'py>,
        time_ns: PyReadonlyArray1<'py, i64>,
        value: PyReadonlyArray2<'py, f64>,
        density: PyReadonlyArray2<'py, f64>,
        kind: PyReadonlyArray1<'py, u8>,
    ) -> PyResult<Vec<OutputTuple<'py>>> {
        let samples = PySamples { axes: self.own.estimator.settings().axes, time_ns, value, density, kind };
        let (view, own) = (samples.view()?, &mut self.own);
        let outputs = py.detach(|| own.push(view));
        Ok(outputs.into_iter().map(|one| output_tuple(py, one)).collect())
    }

    fn measure(
        &mut self,
        time_ns: PyReadonlyArray1<'_, i64>,
        channel: PyReadonlyArray1<'_, i64>,
        value: PyReadonlyArray1<'_, f64>,
        variance: PyReadonlyArray1<'_, f64>,
        reference_variance: PyReadonlyArray1<'_, f64>,
    ) -> PyResult<()> {
        measure(&mut self.own.estimator, &time_ns, &channel, [&value, &variance, &reference_variance])
    }

    fn doubt(&mut self, time_ns: i64) {
        self.own.estimator.doubt(time_ns);
    }

    fn finish<'py>(&mut self, py: Python<'py>) -> Vec<OutputTuple<'py>> {
        let own = &mut self.own;
        let outputs = py.detach(|| own.finish());
        outputs.into_iter().map(|one| output_tuple(py, one)).collect()
    }

    fn predict(&self, channel: usize, time_ns: i64) -> PyResult<Option<(f64, f64)>> {
        predict(&self.own.estimator, channel, time_ns)
    }

    fn parameters(&self) -> Parameters {
        parameters(&self.own.estimator)
    }

    /// How many samples, decided and undecided measurements are held.
    fn held(&mut self) -> (usize, usize, usize) {
        self.own.held()
    }

    fn state<'py>(&mut self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        Ok(PyBytes::new(py, &to_bytes(&self.own.memory()).map_err(state_error)?))
    }

    fn restore(&mut self, state: &[u8]) -> PyResult<()> {
        let memory = from_bytes(state).map_err(state_error)?;
        if self.own.restore(memory) { Ok(()) } else { Err(state_error(StateError::OtherSettings)) }
    }
}

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<Estimator>()?;
    module.add_class::<PyLag>()
}
