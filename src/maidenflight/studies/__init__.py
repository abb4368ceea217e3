"""Studies: tables of tasks that run on one machine or many, each computed once.

`study` reads a table of verbs, `store` keeps results, `worker` performs one
task, engines (`local`, `on_ray`, `slurm`) bring tasks to workers, and `sweeping` drives them.
"""
