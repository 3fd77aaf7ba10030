"""The solvers that `orbimpc bench` runs side by side, one a file, each as its best user would."""
