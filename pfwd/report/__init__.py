"""Reports of surveys: gathered once, then written as one HTML file or a PDF.

::

    from pfwd.report.report import ReportOptions, write_report
    write_report("site-12", "report.html", ReportOptions(language="de"))
"""
