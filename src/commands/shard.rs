//! Which share of a bake this process is to make.
//!
//! In: the text of `--shard`, and the variables in which engines tell a task its number. Out: a [`Share`].

use geofan_bake::Share;

/// The variables of an engine: the number of a task, of the first task, and of the last. Those that do not tell
/// the last have no name for it and need `--shard auto/N`.
struct TaskVariables {
    number: &'static str,
    /// Where numbers begin, if the engine does not say.
    first: (&'static str, u32),
    last: &'static str,
}

/// The engines that are known, the one that is most often inside another first.
const ENGINES: [TaskVariables; 6] = [
    // GNU parallel.
    TaskVariables {
        number: "PARALLEL_SEQ",
        first: ("", 1),
        last: "",
    },
    // Slurm: `sbatch --array`.
    TaskVariables {
        number: "SLURM_ARRAY_TASK_ID",
        first: ("SLURM_ARRAY_TASK_MIN", 1),
        last: "SLURM_ARRAY_TASK_MAX",
    },
    // Kubernetes: a job with `completionMode: Indexed`.
    TaskVariables {
        number: "JOB_COMPLETION_INDEX",
        first: ("", 0),
        last: "",
    },
    // Grid Engine: `qsub -t`.
    TaskVariables {
        number: "SGE_TASK_ID",
        first: ("SGE_TASK_FIRST", 1),
        last: "SGE_TASK_LAST",
    },
    // PBS: `qsub -J`.
    TaskVariables {
        number: "PBS_ARRAY_INDEX",
        first: ("", 1),
        last: "",
    },
    // LSF: `bsub -J name[1-N]`.
    TaskVariables {
        number: "LSB_JOBINDEX",
        first: ("", 1),
        last: "LSB_JOBINDEX_END",
    },
];

/// Reads a share of the chunks: `1/4`, or `auto` and `auto/4` where an engine tells the number.
///
/// # Errors
/// A message for the user.
pub fn share(text: &str) -> Result<Share, String> {
    share_in(text, |name| std::env::var(name).ok())
}

/// Reads it where `variable` looks up the variables of the process.
fn share_in(text: &str, variable: impl Fn(&str) -> Option<String>) -> Result<Share, String> {
    let wrong = || format!("`{text}` is not a share: write 1/4 for the first of four, or auto");
    let number = |text: &str| text.trim().parse::<u32>().map_err(|_| wrong());
    let (index, of) = match text.split_once('/') {
        None if text == "auto" => task(None, variable)?,
        None => return Err(wrong()),
        Some(("auto", of)) => task(Some(number(of)?), variable)?,
        Some((index, of)) => (number(index)?, number(of)?),
    };
    match (1..=of).contains(&index) {
        true => Ok(Share { index, of }),
        false => Err(format!(
            "share {index} of {of}: shares are numbered from 1 to {of}"
        )),
    }
}

/// Finds the number of this task, from 1, and the number of tasks, if it is not given.
fn task(of: Option<u32>, variable: impl Fn(&str) -> Option<String>) -> Result<(u32, u32), String> {
    let number = |name: &str| variable(name).and_then(|text| text.trim().parse::<u32>().ok());
    for engine in &ENGINES {
        let Some(task) = number(engine.number) else {
            continue;
        };
        let first = number(engine.first.0).unwrap_or(engine.first.1);
        let index = (u64::from(task) + 1).checked_sub(first.into());
        let index = index.ok_or_else(|| format!("{} is below {first}", engine.number))?;
        let counted =
            || number(engine.last).and_then(|last| last.checked_sub(first)?.checked_add(1));
        let of = of.or_else(counted).ok_or_else(|| {
            let name = engine.number;
            format!(
                "{name} tells the number of this task, nothing how many there are: write auto/N"
            )
        })?;
        return Ok((u32::try_from(index).unwrap_or(u32::MAX), of));
    }
    let names: Vec<&str> = ENGINES.iter().map(|engine| engine.number).collect();
    Err(format!(
        "auto: none of the variables {} is set",
        names.join(", ")
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with(variables: &[(&str, &str)], text: &str) -> Result<(u32, u32), String> {
        let find = |name: &str| {
            let found = variables.iter().find(|(known, _)| *known == name);
            found.map(|(_, value)| value.to_string())
        };
        share_in(text, find).map(|share| (share.index, share.of))
    }

    #[test]
    fn shares_are_numbered_from_one() {
        assert_eq!(with(&[], "3/4"), Ok((3, 4)));
        for text in ["0/4", "5/4", "3", "x/4", "3/", "auto", "auto/0", ""] {
            assert!(with(&[], text).is_err(), "{text}");
        }
    }

    #[test]
    fn engines_tell_the_number_of_a_task() {
        let slurm = [
            ("SLURM_ARRAY_TASK_ID", "7"),
            ("SLURM_ARRAY_TASK_MIN", "5"),
            ("SLURM_ARRAY_TASK_MAX", "8"),
        ];
        assert_eq!(with(&slurm, "auto"), Ok((3, 4)));
        assert_eq!(with(&slurm, "auto/9"), Ok((3, 9)));
        let kubernetes = [("JOB_COMPLETION_INDEX", "0")];
        assert_eq!(with(&kubernetes, "auto/4"), Ok((1, 4)));
        assert!(with(&kubernetes, "auto").unwrap_err().contains("auto/N"));
        assert!(with(&kubernetes, "auto/0").is_err());
        let grid_engine = [
            ("SGE_TASK_ID", "2"),
            ("SGE_TASK_FIRST", "1"),
            ("SGE_TASK_LAST", "6"),
        ];
        assert_eq!(with(&grid_engine, "auto"), Ok((2, 6)));
        assert_eq!(with(&[("PARALLEL_SEQ", "3")], "auto/3"), Ok((3, 3)));
        // What is no task of an array.
        assert!(with(&[("SGE_TASK_ID", "undefined")], "auto/3").is_err());
    }
}
