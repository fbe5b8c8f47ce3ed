//! The experiments: loss against M, risk against N, budgets, sample predictions, roughness.

mod budget;
mod condition;
mod data;
mod loss_against_observations;
mod loss_example;
mod repeat;
mod roughness;

use distreg::{Distribution, histogram};
use locsim_core::{Draw, Stage};

use super::results::{Results, Samples};
use super::{Kind, Study, StudyError, StudyOptions, claims, families};
use condition::run_condition;
use locsim_report::store::Parts;
use loss_example::loss_example;
use roughness::neighbours;

/// Content of figures beside the results.
pub(super) struct Extra {
    /// Per condition.
    pub conditions: Vec<Samples>,
    /// Reference, near and far prediction of Fig. 5.
    pub loss_example: [Distribution; 3],
    /// Some rays of a static lidar, each with the families fitted to it; the state is the ray's number.
    pub rays: Samples,
    /// Grass: true distributions of neighbouring states, with the distance from the first.
    pub neighbours: Vec<(f64, Distribution)>,
}

/// Purposes of an experiment's draws.
#[derive(Clone, Copy)]
enum Purpose {
    Training = 1,
    Test = 2,
    Folds = 3,
    Observations = 4,
    Roughness = 5,
    Own = 6,
    Thinning = 7,
}

/// Does every experiment of a study. Repeats that are done are kept in `parts`.
pub(super) fn run(
    study: &Study,
    parts: &Parts,
    options: &StudyOptions<'_>,
) -> Result<(Results, Extra), StudyError> {
    let mut conditions = Vec::new();
    let mut samples = Vec::new();
    for number in 0..study.setup.conditions.len() {
        let (results, drawn) = run_condition(study, number, parts, options)?;
        conditions.push(results);
        samples.push(drawn);
    }
    options.control.progress.stage("figures and report", 1);
    let (losses, loss_example) = loss_example(study)?;
    let families = (study.kind == Kind::StaticLidar).then(|| families::compare(study)).transpose()?;
    let rays = families::shown(study)?;
    let neighbours = neighbours(study)?;
    let mut results = Results {
        study: study.name.clone(),
        sensor: study.kind.as_str(),
        seed: study.seed,
        repeats: study.repeats,
        quick: study.quick,
        bins: study.setup.outcomes.grid.bins,
        bin_width: study.setup.outcomes.grid.width,
        conditions,
        losses,
        families,
        claims: Vec::new(),
    };
    results.claims = claims::claims(study, &results);
    Ok((results, Extra { conditions: samples, loss_example, rays, neighbours }))
}

impl Study {
    /// The draws of one repeat of an experiment: the same for every condition, so that these see the same states.
    fn draw(&self, purpose: Purpose, repeat: u32) -> Draw {
        let seed = Draw::new(self.seed, Stage::Trial, purpose as u32).seed(0);
        Draw::new(seed, Stage::Training, repeat)
    }

    pub(super) fn histogram(&self, observations: &[f64]) -> Result<Distribution, StudyError> {
        Ok(histogram(observations, &self.setup.outcomes)?)
    }
}

impl Kind {
    /// As in a study's file.
    pub(super) fn as_str(self) -> &'static str {
        self.into()
    }
}
