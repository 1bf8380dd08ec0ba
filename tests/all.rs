//! The end-to-end tests of the command and the checks of the repository, one module each. They form one binary, which
//! is linked once. The tests mostly wait for processes, so they run side by side.

mod support;

mod arrows;
mod assumptions;
mod check;
mod checks;
mod circles;
mod classes;
mod command;
mod commands;
mod conformance;
mod demo;
mod examples;
mod explore;
mod faults_seen;
mod front_door;
mod guide;
mod hostile;
mod kept_out;
mod link_health;
mod load;
mod monitor;
mod network;
mod observe;
mod path_of_the_model;
mod planted;
mod random_runs;
mod run;
mod run_node;
mod screen;
mod simulate;
mod slow_reader;
mod specs;
mod test_files;
mod tidy;
mod transcripts;
mod twins;
mod two_owners;
mod unit;
mod verify_cell;
mod verify_times;
