//! `locsim-bench regression`.

use predicates::str::contains;

use crate::bench;

#[test]
fn a_folder_without_the_task_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    bench(folder.path(), "regression .").code(2).stderr(contains("the folder that holds task.py"));
}
