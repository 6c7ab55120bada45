//! Measures everything of a sweep that is not yet measured, then writes the results.

use super::{
    SweepOptions, SweepSummary,
    point::Store,
    report,
    subject::{Results, Shared, Subject},
    table,
};
use geofan_core::{Error, Observer, Progress, Result};

/// Measures everything that is not yet measured, then writes the results.
///
/// # Errors
/// Bad input, an interruption, or a folder that cannot be written.
pub fn run(options: &SweepOptions, observer: &dyn Observer) -> Result<SweepSummary> {
    std::fs::create_dir_all(&options.out).map_err(|e| Error::io(&options.out, e))?;
    if let Some(tensor) = &options.tensor {
        let mut lines = Vec::new();
        for manifold in &options.manifolds {
            let path = tensor.write(manifold, &options.out, observer, &mut lines)?;
            lines.push(format!("{}\n", path.display()));
        }
        return Ok(SweepSummary {
            lines,
            points: 0,
            measured: 0,
        });
    }
    let store = Store::open(&options.out)?;
    let shared = Shared {
        store: &store,
        observer,
        options,
    };
    let subjects = options
        .manifolds
        .iter()
        .map(|path| Subject::load(path, &shared));
    let subjects: Vec<Subject> = subjects.collect::<Result<_>>()?;
    names_differ(&subjects)?;
    let all = measured(&subjects, observer)?;
    table::write(&options.out.join("sweep.csv"), &all)?;
    report::write(&options.out, &all, &options.command)?;
    let points = all.iter().flat_map(|results| &results.points);
    let (points, measured) = points.fold((0, 0), |(all, done), point| {
        (all + 1, done + usize::from(point.measured().is_some()))
    });
    Ok(SweepSummary {
        lines: Vec::new(),
        points,
        measured,
    })
}

/// That no two manifolds would share the names of their points and figures.
fn names_differ(subjects: &[Subject<'_>]) -> Result<()> {
    for (k, subject) in subjects.iter().enumerate() {
        let name = subject.name();
        if subjects[..k].iter().any(|other| other.name() == name) {
            let message = "two manifold files have this name: sweep them into folders of their own";
            return Err(Error::input(name, message));
        }
    }
    Ok(())
}

fn measured(subjects: &[Subject<'_>], observer: &dyn Observer) -> Result<Vec<Results>> {
    let total = subjects.iter().map(Subject::work).sum();
    let done = std::cell::Cell::new(0);
    let mut all = Vec::new();
    for subject in subjects {
        let name = subject.name();
        all.push(subject.measure(|what| {
            done.set(done.get() + 1);
            observer.progress(Progress {
                work: "measuring",
                done: done.get(),
                total,
                detail: &format!("{name}: {what}"),
            });
        })?);
    }
    Ok(all)
}
