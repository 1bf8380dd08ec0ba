//! Where the communication tasks of a node are: in which domain, and at which place there (D186).

use imrs_protocol::TaskId;

/// Which thread runs the program of a task.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum RunBy {
    /// A thread of the task's own.
    ItsThread,
    /// The program is a script: the thread that brings it input.
    AnyThread,
    /// The program is a future.
    TheThreadOfFutures,
}

/// Where a communication task of the node is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Home {
    /// Its position among the node's tasks.
    pub place: usize,
    /// Its domain: the place of that domain's first member.
    pub domain: usize,
    /// Its position among the members of the domain.
    pub member: usize,
    /// Which thread runs the task's program: the same for all members of a domain.
    pub run_by: RunBy,
}

/// Where the communication tasks of a node are.
#[derive(Debug)]
pub(crate) struct Homes {
    /// For each task of the cell.
    of_task: Box<[Option<Home>]>,
    /// For each task of the node, ascending by task.
    of_place: Box<[Home]>,
}

impl Homes {
    /// The homes of `local`, the tasks of a node, ascending; each with what runs it. The cell has `tasks` tasks.
    pub fn new(local: impl Iterator<Item = (TaskId, RunBy)>, tasks: usize) -> Self {
        let mut of_task = vec![None; tasks];
        let mut of_place = Vec::new();
        let (mut scripts, mut futures) = (None, None);
        for (place, (task, run_by)) in local.enumerate() {
            let shared: Option<&mut Option<(usize, usize)>> = match run_by {
                RunBy::ItsThread => None,
                RunBy::AnyThread => Some(&mut scripts),
                RunBy::TheThreadOfFutures => Some(&mut futures),
            };
            let (domain, member) = match shared {
                None => (place, 0),
                Some(shared) => {
                    let (domain, count) = shared.get_or_insert((place, 0));
                    *count += 1;
                    (*domain, *count - 1)
                }
            };
            let home = Home { place, domain, member, run_by };
            of_place.push(home);
            of_task[task.index()] = Some(home);
        }
        Self { of_task: of_task.into(), of_place: of_place.into() }
    }

    /// The home of `task`, if this node runs it.
    pub fn of(&self, task: TaskId) -> Option<Home> {
        self.of_task.get(task.index()).copied().flatten()
    }

    /// The home of the task at a place of the node.
    pub fn at(&self, place: usize) -> Home {
        self.of_place[place]
    }
}
