"""Child processes: functions isolated in one, external programs under limits, modules run in one."""
