//! Scripts that hand the shards of a sweep to a batch engine. Which task failed and when it is tried again is the engine's; a
//! task that is tried again goes on with what it has kept.

use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::process::Command;

use locsim_core::output::write_file;

use crate::SweepError;
use crate::sweep::{ARGUMENTS, COMMAND};

/// A batch engine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Engine {
    /// Slurm, an array job.
    Slurm,
    /// `HyperQueue`, a task array.
    HyperQueue,
    /// GNU parallel, on this machine.
    Parallel,
}

/// The shards of a sweep as tasks of an engine.
#[derive(Clone, Debug)]
pub struct Job {
    /// The engine.
    pub engine: Engine,
    /// Name of the sweep.
    pub name: String,
    /// Number of shards.
    pub shards: u32,
    /// Threads of each.
    pub threads: usize,
    /// The program.
    pub program: PathBuf,
    /// Its arguments, without those that name the shard.
    pub arguments: Vec<String>,
    /// Folder of the shards, an absolute path; the scripts go into `engine/` there.
    pub out: PathBuf,
    /// Lines around the command.
    pub template: Option<String>,
}

impl Job {
    /// Writes `engine/shard.sh`, which runs one shard, and `engine/submit.sh`, which submits all. Returns the path of the latter.
    ///
    /// # Errors
    /// [`SweepError::File`].
    pub fn write(&self) -> Result<PathBuf, SweepError> {
        let folder = self.out.join("engine");
        let at = |path: &Path| {
            let path = path.to_owned();
            move |source| SweepError::File { path, source }
        };
        // Slurm and HyperQueue don't make the folder of their logs.
        let logs = folder.join("logs");
        std::fs::create_dir_all(&logs).map_err(at(&logs))?;
        let submit = folder.join("submit.sh");
        for (path, text) in
            [(folder.join("shard.sh"), self.shard_script()), (submit.clone(), self.submit_script())]
        {
            write_file(&path, |file| file.write_all(text.as_bytes())).map_err(at(&path))?;
        }
        Ok(submit)
    }

    /// Submits the job by its script.
    ///
    /// # Errors
    /// [`SweepError::Submit`].
    pub fn submit(script: &Path) -> Result<(), SweepError> {
        let failed = |what: String| SweepError::Submit { script: script.to_owned(), what };
        let status = Command::new("sh").arg(script).status().map_err(|error| failed(error.to_string()))?;
        if status.success() { Ok(()) } else { Err(failed(format!("failed ({status})"))) }
    }

    fn engine_file(&self, name: &str) -> String {
        quoted(&self.out.join("engine").join(name).display().to_string())
    }

    /// Runs one shard.
    fn shard_script(&self) -> String {
        let Self { shards, threads, .. } = self;
        let (head, task) = match self.engine {
            Engine::Slurm => {
                let logs = self.out.join("engine/logs/%a.log");
                let head = format!(
                    "#SBATCH --job-name={}\n#SBATCH --array=1-{shards}\n#SBATCH --cpus-per-task={threads}\n\
                     #SBATCH --output={}\n",
                    self.name,
                    quoted(&logs.display().to_string())
                );
                (head, "\"$SLURM_ARRAY_TASK_ID\"")
            }
            Engine::HyperQueue => (String::new(), "\"$HQ_TASK_ID\""),
            Engine::Parallel => (String::new(), "\"$1\""),
        };
        let mut arguments = self.arguments.iter().map(|word| quoted(word)).collect::<Vec<_>>().join(" ");
        let _ = write!(arguments, " --threads {threads} --shard {task}/{shards}");
        let command = format!("{} {arguments}", quoted(&self.program.display().to_string()));
        let template = self.template.as_deref().unwrap_or(COMMAND);
        let body = template.replace(COMMAND, &command).replace(ARGUMENTS, &arguments);
        format!(
            "#!/bin/sh\n{head}# One shard of the sweep {}. Written by `locsim sweep --engine`.\n{}\n",
            self.name,
            body.trim_end()
        )
    }

    /// Submits all shards; Slurm and `HyperQueue` take other numbers of tasks as an argument: `submit.sh 3,7-9`.
    fn submit_script(&self) -> String {
        let Self { name, shards, threads, .. } = self;
        let shard = self.engine_file("shard.sh");
        let line = match self.engine {
            Engine::Slurm => format!("exec sbatch --array=\"${{1:-1-{shards}}}\" {shard}"),
            Engine::HyperQueue => {
                let log = self.engine_file("logs/%{TASK_ID}.log");
                format!(
                    "exec hq submit --name={name} --array=\"${{1:-1-{shards}}}\" --cpus={threads} --stdout={log} \
                     --stderr={log} -- sh {shard}"
                )
            }
            Engine::Parallel => {
                let jobs = if *threads == 1 {
                    "100%".to_owned()
                } else {
                    format!("\"$(( $(nproc) / {threads} ))\"")
                };
                format!(
                    "seq 1 {shards} | parallel --jobs {jobs} --joblog {} --resume-failed sh {shard} {{}}",
                    self.engine_file("joblog")
                )
            }
        };
        format!("#!/bin/sh\n# The shards of the sweep {name}. Written by `locsim sweep --engine`.\n{line}\n")
    }
}

/// A word for a shell.
fn quoted(word: &str) -> String {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_/.=:,%+@".contains(c);
    if !word.is_empty() && word.chars().all(is_plain) {
        word.to_owned()
    } else {
        format!("'{}'", word.replace('\'', "'\\''"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn job(engine: Engine, template: Option<&str>) -> Job {
        Job {
            engine,
            name: "clutter".to_owned(),
            shards: 50,
            threads: 2,
            program: PathBuf::from("/opt/locsim"),
            arguments: ["sweep", "/data/my sweep.yaml", "--out", "/scratch/o"].map(str::to_owned).to_vec(),
            out: PathBuf::from("/scratch/o"),
            template: template.map(str::to_owned),
        }
    }

    #[test]
    fn a_script_of_slurm_has_its_directives_before_the_first_command() {
        let template = "#SBATCH --time=10\nmodule load gcc\napptainer exec lab.sif locsim {arguments}\n";
        let script = job(Engine::Slurm, Some(template)).shard_script();
        let lines: Vec<&str> = script.lines().collect();
        assert_eq!(lines[..3], ["#!/bin/sh", "#SBATCH --job-name=clutter", "#SBATCH --array=1-50"]);
        let last = lines.iter().rposition(|line| line.starts_with("#SBATCH")).unwrap();
        assert!(lines[..last].iter().all(|line| line.starts_with('#')), "{script}");
        let command = "apptainer exec lab.sif locsim sweep '/data/my sweep.yaml' --out /scratch/o --threads 2 --shard \
                       \"$SLURM_ARRAY_TASK_ID\"/50";
        assert_eq!(lines.last(), Some(&command));
        assert!(
            job(Engine::Slurm, None)
                .submit_script()
                .contains("exec sbatch --array=\"${1:-1-50}\" /scratch/o/engine/shard.sh")
        );
    }

    #[test]
    fn each_engine_names_the_task_in_its_own_way() {
        for (engine, task) in [(Engine::HyperQueue, "\"$HQ_TASK_ID\"/50"), (Engine::Parallel, "\"$1\"/50")] {
            let script = job(engine, None).shard_script();
            assert!(script.trim_end().ends_with(task), "{script}");
        }
        let submit = job(Engine::Parallel, None).submit_script();
        assert!(
            submit.contains(
                "--joblog /scratch/o/engine/joblog --resume-failed sh /scratch/o/engine/shard.sh {}"
            ),
            "{submit}"
        );
        let submit = job(Engine::HyperQueue, None).submit_script();
        assert!(submit.contains("--array=\"${1:-1-50}\" --cpus=2"), "{submit}");
    }

    #[test]
    fn words_are_quoted_for_the_shell() {
        assert_eq!(quoted("a b"), "'a b'");
        assert_eq!(quoted("it's $HOME"), "'it'\\''s $HOME'");
        assert_eq!(quoted(""), "''");
        assert_eq!(quoted("/a-b/c.yaml"), "/a-b/c.yaml");
    }
}
