//! `estimator` for Python.

use super::elements;
use super::settings::PySettings;
use crate::estimator::lag::Lag;
use crate::estimator::matrix::Matrix;
use crate::estimator::model::instant;
use crate::estimator::reports::{Report, What};
use crate::estimator::rows::{AxisRows, Innovations, Output, Rows};
use crate::estimator::run::Filter;
use crate::estimator::samples::View;
use crate::estimator::second_pass::smooth;
use crate::estimator::state::{StateError, from_bytes, to_bytes};
use crate::estimator::stream::{self, Limits};
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
/// Stamps, values, variances and codes of what became of each measurement (m,) of one channel.
type InnovationArrays<'py> =
    (Bound<'py, PyArray1<i64>>, Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<i8>>);
/// What happened (see [`code`]): when (ns), to which channel, size (mm), its standard deviation (mm), of outliers in a
/// row how many and how long (s).
type ReportTuple = (u8, i64, usize, f64, f64, usize, f64);
/// Rows or None, innovations of each channel, events, variance of the zero of each axis.
type OutputTuple<'py> = (Option<RowArrays<'py>>, Vec<InnovationArrays<'py>>, Vec<ReportTuple>, Vec<f64>);

/// Stamps (n,), values and densities (n · axes,) and kinds (n,).
type SampleArrays<'py> =
    (Bound<'py, PyArray1<i64>>, Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<u8>>);
/// Time (s), states (n, 1 + k) and covariance (n, n).
type FilterTuple<'py> = (f64, Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<f64>>);

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
        one.acceptance.into_pyarray(py),
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
    let count = own.settings.channels.len();
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

fn matrix<'py>(py: Python<'py>, one: &Matrix) -> Bound<'py, PyArray2<f64>> {
    let rows: Vec<Vec<f64>> = (0..one.height()).map(|i| one.row(i).to_vec()).collect();
    PyArray2::from_vec2(py, &rows).unwrap_or_else(|_| PyArray2::zeros(py, [0, 0], false))
}

/// A stream: rows as they come, or a lag later.
enum Stream {
    Causal(Box<stream::Estimator>),
    Lagged(Box<Lag>),
}

/// See [`stream::Estimator`] and [`Lag`].
#[pyclass(module = "midspan._core")]
struct Estimator {
    stream: Stream,
}

impl Estimator {
    fn own(&self) -> &stream::Estimator {
        match &self.stream {
            Stream::Causal(own) => own,
            Stream::Lagged(lag) => &lag.estimator,
        }
    }

    fn own_mut(&mut self) -> &mut stream::Estimator {
        match &mut self.stream {
            Stream::Causal(own) => own,
            Stream::Lagged(lag) => &mut lag.estimator,
        }
    }
}

#[pymethods]
impl Estimator {
    /// lag_samples: rows come this many samples later, whatever `log` and `rows` say; None: as they come.
    #[new]
    #[pyo3(signature = (settings, *, log, rows, waiting, block, lag_samples))]
    fn new(
        settings: PySettings,
        log: bool,
        rows: bool,
        waiting: usize,
        block: usize,
        lag_samples: Option<usize>,
    ) -> PyResult<Self> {
        let (settings, lagged) = (settings.converted()?, lag_samples.is_some());
        let limits = Limits { waiting: waiting.max(1), block: block.max(1) };
        let own = stream::Estimator::new(settings, limits, log || lagged, rows && !lagged);
        let stream = match lag_samples {
            Some(lag_samples) => Stream::Lagged(Box::new(Lag::new(own, lag_samples))),
            None => Stream::Causal(Box::new(own)),
        };
        Ok(Self { stream })
    }

    fn push<'py>(
        &mut self,
        py: Python<'py>,
        time_ns: PyReadonlyArray1<'py, i64>,
        value: PyReadonlyArray2<'py, f64>,
        density: PyReadonlyArray2<'py, f64>,
        kind: PyReadonlyArray1<'py, u8>,
    ) -> PyResult<Vec<OutputTuple<'py>>> {
        let samples = PySamples { axes: self.own().settings.axes, time_ns, value, density, kind };
        let (view, stream) = (samples.view()?, &mut self.stream);
        let mut output = None;
        py.detach(|| match stream {
            Stream::Causal(own) => own.push(view, None, &mut output),
            Stream::Lagged(lag) => lag.push(view, &mut output),
        });
        Ok(output.into_iter().map(|one| output_tuple(py, one)).collect())
    }

    fn measure(
        &mut self,
        time_ns: PyReadonlyArray1<'_, i64>,
        channel: PyReadonlyArray1<'_, i64>,
        value: PyReadonlyArray1<'_, f64>,
        variance: PyReadonlyArray1<'_, f64>,
        reference_variance: PyReadonlyArray1<'_, f64>,
    ) -> PyResult<()> {
        measure(self.own_mut(), &time_ns, &channel, [&value, &variance, &reference_variance])
    }

    fn doubt(&mut self, time_ns: i64) {
        self.own_mut().doubt(time_ns);
    }

    fn finish<'py>(&mut self, py: Python<'py>) -> Vec<OutputTuple<'py>> {
        let stream = &mut self.stream;
        let mut output = None;
        py.detach(|| match stream {
            Stream::Causal(own) => own.finish(&mut output),
            Stream::Lagged(lag) => lag.finish(&mut output),
        });
        output.into_iter().map(|one| output_tuple(py, one)).collect()
    }

    fn predict(&self, channel: usize, time_ns: i64) -> PyResult<Option<(f64, f64)>> {
        let own = self.own();
        if channel >= own.settings.channels.len() {
            return Err(PyValueError::new_err(format!("channel: {channel}")));
        }
        Ok(own.predict(channel, time_ns))
    }

    /// The row of each axis at the newest sample, which is logged, before it is smoothed; None where there is none.
    fn head<'py>(&self, py: Python<'py>) -> Option<RowArrays<'py>> {
        self.own().head().map(|rows| row_arrays(py, rows))
    }

    /// Parameters (k,) and their variances (k,).
    fn parameters(&self) -> (Vec<f64>, Vec<f64>) {
        let own = self.own();
        match own.memory.filter.as_ref().map(|filter| filter.hyps.best()) {
            Some(best) => {
                let k = best.parameters.len();
                (best.parameters.clone(), (0..k).map(|q| best.spread[(q, q)]).collect())
            }
            None => own.settings.parameters.iter().map(|one| (0.0, one.std * one.std)).unzip(),
        }
    }

    /// What is added to the stamps of each channel (c,), s, besides its parameter.
    fn clock_offsets(&self) -> Vec<f64> {
        let own = self.own();
        (0..own.settings.channels.len()).map(|c| own.memory.clocks.offset_s(c)).collect()
    }

    fn state<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        let bytes = match &self.stream {
            Stream::Causal(own) => to_bytes(&own.memory),
            Stream::Lagged(lag) => to_bytes(&lag.memory()),
        };
        Ok(PyBytes::new(py, &bytes.map_err(state_error)?))
    }

    fn restore(&mut self, state: &[u8]) -> PyResult<()> {
        let fits = match &mut self.stream {
            Stream::Causal(own) => own.restore(from_bytes(state).map_err(state_error)?),
            Stream::Lagged(lag) => lag.restore(from_bytes(state).map_err(state_error)?),
        };
        if fits { Ok(()) } else { Err(state_error(StateError::OtherSettings)) }
    }

    /// How many samples, decided and undecided measurements are held.
    fn held(&self) -> (usize, usize, usize) {
        let own = self.own();
        let (samples, decided) = own.log.as_ref().map_or((0, 0), |log| (log.samples.len(), log.decided.len()));
        (samples, decided, own.memory.undecided.len())
    }

    /// Times (s) and channels of what waits for samples, -1 for the datum, -2 for stamps that went back, -3 for a clock's step or drift.
    fn waiting(&self) -> (Vec<f64>, Vec<i64>) {
        let channel = |item: &Item| match item {
            Item::Measured(one) => one.channel as i64,
            Item::Datum => -1,
            Item::WentBack => -2,
            Item::ClockStep { .. } | Item::Relinearised { .. } => -3,
        };
        self.own().memory.waiting.iter().map(|one| (one.at_s, channel(&one.item))).unzip()
    }

    /// How many measurements wait for the first sample.
    fn early(&self) -> usize {
        self.own().memory.early.len()
    }

    /// Time (s), states (n, 1 + k) and covariance (n, n) of the best hypothesis; None before the filter has begun.
    fn filter<'py>(&self, py: Python<'py>) -> Option<FilterTuple<'py>> {
        let filter: &Filter = self.own().memory.filter.as_ref()?;
        let best = filter.hyps.best();
        Some((filter.clock.time_s, matrix(py, &best.x), matrix(py, &best.p)))
    }

    /// Whether there is a log.
    fn logs(&self) -> bool {
        self.own().log.is_some()
    }

    /// The rows of each axis, smoothed by the whole record that was logged.
    fn smooth<'py>(&self, py: Python<'py>, settings: PySettings, logged: bool) -> PyResult<RowArrays<'py>> {
        let settings = settings.converted()?;
        let own = self.own();
        let log = own.log.as_ref().ok_or_else(|| PyValueError::new_err("no log"))?;
        let known = &own.settings;
        let same_table = settings.channels.len() == known.channels.len() && settings.axes == known.axes;
        if !same_table {
            return Err(PyValueError::new_err("settings: of other channels or axes"));
        }
        let logged = logged && settings.parameters.len() == known.parameters.len();
        let rows = py.detach(|| smooth(log, &settings, logged, own.limits.block));
        Ok(row_arrays(py, rows))
    }

    /// Stamps (k,) from which on clocks were in doubt in what was logged.
    fn went_back_ns(&self) -> Vec<i64> {
        let log = self.own().log.as_ref();
        log.map_or_else(Vec::new, |log| log.went_back_s().iter().map(|&at_s| instant(at_s, log.origin_ns)).collect())
    }

    /// Whether a clock may have stepped, and by how much is looked for.
    fn seeks_clock(&self) -> bool {
        self.own().memory.clocks.bank.is_some()
    }

    /// After how many samples the filter was logged.
    fn logged_filters(&self) -> Vec<usize> {
        self.own().log.as_ref().map_or_else(Vec::new, |log| log.filters.keys().copied().collect())
    }

    /// Stamps (n,), values and densities (n · axes,) and kinds (n,) of what was logged.
    fn logged_samples<'py>(&self, py: Python<'py>) -> Option<SampleArrays<'py>> {
        let one = &self.own().log.as_ref()?.samples;
        let (time_ns, kind) = (PyArray1::from_slice(py, &one.time_ns), PyArray1::from_slice(py, &one.kind));
        Some((time_ns, PyArray1::from_slice(py, &one.value), PyArray1::from_slice(py, &one.density), kind))
    }
}

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<Estimator>()
}
